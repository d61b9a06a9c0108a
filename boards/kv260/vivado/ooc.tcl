# The core alone, out of context: minutes in place of an hour, for a first look at clock and area, for sweeps, and for
# other boards. Ports have no constraints, so only paths between registers count.
#
#   vivado -mode batch -source ooc.tcl -tclargs VERILOG FOLDER MHZ [PART]
#
# FOLDER gets routed.dcp, summary.json (fmax_mhz) and reports/. Exit status 1 if timing is missed.

source [file join [file dirname [info script]] common.tcl]

guarded {
    require_vivado
    if {[llength $argv] != 3 && [llength $argv] != 4} {
        error "expected VERILOG FOLDER MHZ \[PART\], got \"$argv\""
    }
    lassign $argv verilog folder mhz part
    if {$part ne ""} {
        set fact(part) $part
    }
    if {![string is double -strict $mhz] || $mhz <= 0} {
        error "MHZ must be a positive number, got \"$mhz\""
    }
    if {![file exists $verilog]} {
        error "$verilog does not exist: make rtl"
    }
    file mkdir $folder
    set folder [file normalize $folder]

    set clock_file [file join $folder clock.xdc]
    set channel [open $clock_file w]
    puts $channel "create_clock -name aclk -period [format %.3f [expr {1000.0 / $mhz}]] \[get_ports aclk\]"
    close $channel

    read_verilog $verilog
    read_xdc -mode out_of_context $clock_file
    synth_design -mode out_of_context -top $fact(top) -part $fact(part)
    opt_design
    place_design
    phys_opt_design
    route_design
    write_checkpoint -force [file join $folder routed.dcp]
    write_reports [file join $folder reports]
    set timing [timing_figures]
    finish [file join $folder summary.json] out_of_context $mhz $timing [complaints $timing]
}
