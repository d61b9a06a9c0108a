# What the scripts of this folder share: the facts, an exit status that can be trusted, checks of a routed design,
# and summary.json.

source [file join [file dirname [info script]] facts.tcl]

# Run `body`, and end Vivado with status 1 and one line if anything in it failed.
proc guarded {body} {
    if {[catch {uplevel #0 $body} message]} {
        puts "ERROR: cmfpga: $message"
        exit 1
    }
}

proc require_vivado {} {
    global fact
    set found [version -short]
    if {[package vcompare [scan_version $found] [scan_version $fact(vivado_minimum)]] < 0} {
        error "Vivado $found is too old: the board's files need $fact(vivado_minimum) or newer"
    }
}

# 2022.2, 2023.2.1, 2024.1_AR12345: the numbers in front.
proc scan_version {text} {
    if {![regexp {^[0-9]+(\.[0-9]+)*} $text numbers]} {
        error "cannot read Vivado's version from \"$text\""
    }
    return $numbers
}

# The newest IP of a name: the version differs between releases of Vivado.
proc newest_ip {name} {
    set found [lsort -dictionary [get_ipdefs $name:*]]
    if {[llength $found] == 0} {
        error "Vivado has no IP $name"
    }
    return [lindex $found end]
}

proc exactly_one {what objects} {
    if {[llength $objects] != 1} {
        error "expected exactly one $what, found [llength $objects]: $objects"
    }
    return [lindex $objects 0]
}

# The first group of `pattern` in a report.
proc from_report {what pattern text} {
    if {![regexp -line -- $pattern $text all value]} {
        error "the report has no $what: its layout is not the one that this script knows"
    }
    return $value
}

# Slacks of the routed design, ns, as a dictionary wns tns whs ths wpws tpws, and the number of registers without a
# clock.
proc timing_figures {} {
    set text [report_timing_summary -delay_type min_max -return_string]
    set row {^\s*WNS\(ns\).*\n[-\s]+\n\s*(\S+)\s+(\S+)\s+\S+\s+\S+\s+(\S+)\s+(\S+)\s+\S+\s+\S+\s+(\S+)\s+(\S+)\s+\S+\s+\S+\s*$}
    if {![regexp -line -- $row $text all wns tns whs ths wpws tpws]} {
        error "the report has no row of slacks: its layout is not the one that this script knows"
    }
    set unclocked [from_report "registers without a clock" {checking no_clock \(([0-9]+)\)} $text]
    return [dict create wns $wns tns $tns whs $whs ths $ths wpws $wpws tpws $tpws unclocked $unclocked]
}

proc utilisation_figures {} {
    set text [report_utilization -return_string]
    set figures [dict create]
    foreach {key row} {
        luts "CLB LUTs" registers "CLB Registers" block_rams "Block RAM Tile" ultra_rams URAM dsps DSPs
    } {
        dict set figures $key [from_report $row "^\\|\\s*$row\\*?\\s*\\|\\s*(\[0-9.\]+)\\s*\\|" $text]
    }
    return $figures
}

proc power_watts {} {
    return [from_report "total power" {^\|\s*Total On-Chip Power \(W\)\s*\|\s*([0-9.]+)} [report_power -return_string]]
}

# All that must hold before a bitstream is handed over; returns a list of complaints.
proc complaints {timing} {
    set found {}
    foreach {key text} {wns setup whs hold wpws "pulse width"} {
        set slack [dict get $timing $key]
        if {![string is double -strict $slack]} {
            lappend found "$text timing: no constrained path ($slack)"
        } elseif {$slack < 0} {
            lappend found "$text timing is missed by [expr {-$slack}] ns"
        }
    }
    if {[dict get $timing unclocked] != 0} {
        lappend found "[dict get $timing unclocked] registers have no clock"
    }
    if {[string first "(unsafe)" [report_clock_interaction -delay_type min_max -no_header -return_string]] >= 0} {
        lappend found "clock crossing without constraint, see clock_interaction.rpt"
    }
    if {[string first "Critical" [report_cdc -return_string -no_header -details -severity Critical]] >= 0} {
        lappend found "critical clock-domain crossing, see cdc.rpt"
    }
    return $found
}

proc write_reports {folder} {
    file mkdir $folder
    report_timing_summary -delay_type min_max -max_paths 20 -report_unconstrained -file [file join $folder timing.rpt]
    report_utilization -file [file join $folder utilization.rpt]
    report_utilization -hierarchical -file [file join $folder utilization_hierarchical.rpt]
    report_power -file [file join $folder power.rpt]
    report_clock_interaction -delay_type min_max -file [file join $folder clock_interaction.rpt]
    report_cdc -details -file [file join $folder cdc.rpt]
    report_bus_skew -file [file join $folder bus_skew.rpt]
    report_methodology -file [file join $folder methodology.rpt]
    report_drc -file [file join $folder drc.rpt]
    report_ram_utilization -file [file join $folder ram.rpt]
}

# A flat or once nested dictionary as JSON. Numbers are numbers; everything else is a string.
proc json {values {indent ""}} {
    set lines {}
    foreach {key value} $values {
        if {$key in {timing utilisation}} {
            set text [json $value "$indent  "]
        } elseif {$key eq "complaints"} {
            set quoted {}
            foreach line $value {
                lappend quoted [json_string $line]
            }
            set text "\[[join $quoted {, }]\]"
        } elseif {[regexp {^-?[0-9]+(\.[0-9]+)?$} $value] || $value in {true false null}} {
            set text $value
        } else {
            set text [json_string $value]
        }
        lappend lines "$indent  [json_string $key]: $text"
    }
    return "{\n[join $lines ",\n"]\n$indent}"
}

proc json_string {text} {
    return "\"[string map {\\ \\\\ \" \\\" \n \\n \t \\t} $text]\""
}

# Write summary.json, print it, and fail if there is a complaint.
proc finish {file flow mhz timing complaints} {
    global fact
    set wns [dict get $timing wns]
    set fmax null
    if {[string is double -strict $wns] && 1000.0 / $mhz > $wns} {
        set fmax [format %.1f [expr {1000.0 / (1000.0 / $mhz - $wns)}]]
    }
    set summary [dict create design $fact(name) flow $flow part $fact(part) vivado "Vivado [version -short]" \
        passed [expr {[llength $complaints] ? "false" : "true"}] complaints $complaints \
        clock_mhz $mhz fmax_mhz $fmax timing $timing utilisation [utilisation_figures] power_w [power_watts]]
    set channel [open $file w]
    puts $channel [json $summary]
    close $channel
    puts [json $summary]
    if {[llength $complaints]} {
        error "[join $complaints {; }] (figures are in $file)"
    }
}
