# Generated from boards/kv260/board.toml by boards/kv260/facts.py; do not edit.
APP := cmfpga
TOP := cmfpga_kv260
PART := xck26-sfvc784-2LV-c
CLOCK_MHZ := 200
