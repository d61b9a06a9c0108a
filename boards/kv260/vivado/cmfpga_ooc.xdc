# Generated from boards/kv260/board.toml by boards/kv260/facts.py; do not edit.
# set_property USED_IN out_of_context on this file: in a design the clock comes from outside.
create_clock -name aclk -period 5.000 [get_ports aclk]
