# From the packaged IP to a bitstream that meets timing.
#
#   vivado -mode batch -source build.tcl -tclargs IP_FOLDER FOLDER JOBS
#
# FOLDER gets cmfpga.bit, cmfpga.hwh, cmfpga.xsa, summary.json and reports/. If anything fails, timing included, the
# exit status is 1 and there is no cmfpga.bit; summary.json is there as soon as the design was routed.

source [file join [file dirname [info script]] common.tcl]
source [file join [file dirname [info script]] design.tcl]

# The board's files bring the memory's and the carrier's settings; without them a bitstream would not run.
proc set_board {} {
    global fact
    set found [get_board_parts -quiet -latest_file_version $fact(board_part_pattern)]
    if {[llength $found] == 0} {
        error "no board files for $fact(board_part): install \"Kria SOMs and Starter Kits\" (Vivado's installer, or\
            Tools > Vivado Store > Boards)"
    }
    set_property board_part [exactly_one "board part" $found] [current_project]
    # Before the preset is applied, which asks for it.
    set_property board_connections [list $fact(carrier_connector) $fact(carrier)] [current_project]
}

proc run_to_end {name step jobs} {
    set run [get_runs $name]
    if {$step eq ""} {
        launch_runs $run -jobs $jobs
    } else {
        launch_runs $run -to_step $step -jobs $jobs
    }
    wait_on_run $run
    set status [get_property STATUS $run]
    set expected [expr {$step eq "" ? "synth_design Complete!" : "$step Complete!"}]
    if {$status ne $expected || [get_property PROGRESS $run] ne "100%"} {
        error "$name ended with \"$status\"; see [file join [get_property DIRECTORY $run] runme.log]"
    }
}

guarded {
    require_vivado
    if {[llength $argv] != 3} {
        error "expected IP_FOLDER FOLDER JOBS, got \"$argv\""
    }
    lassign $argv ip_folder folder jobs
    if {![file exists [file join $ip_folder component.xml]]} {
        error "$ip_folder has no component.xml: make ip"
    }
    file mkdir $folder
    set folder [file normalize $folder]
    foreach kind {bit hwh xsa} {
        file delete [file join $folder $fact(name).$kind]
    }
    file delete [file join $folder summary.json]

    set project_folder [file join $folder project]
    create_project -force $fact(name) $project_folder -part $fact(part)
    set_board
    set_property ip_repo_paths [file normalize $ip_folder] [current_project]
    update_ip_catalog
    create_block_design

    set design [get_files $fact(block_design).bd]
    generate_target all $design
    add_files -norecurse [make_wrapper -files $design -top]
    set_property top $fact(block_design)_wrapper [current_fileset]
    add_files -fileset constrs_1 -norecurse [file join [file dirname [file normalize [info script]]] kv260.xdc]
    update_compile_order -fileset sources_1

    run_to_end synth_1 "" $jobs
    run_to_end impl_1 write_bitstream $jobs

    open_run impl_1
    write_reports [file join $folder reports]
    set timing [timing_figures]
    finish [file join $folder summary.json] implementation $fact(clock_mhz) $timing [complaints $timing]

    write_hw_platform -fixed -include_bit -force -file [file join $folder $fact(name).xsa]
    # PYNQ and xmutil want one base name for all files; the bitstream comes last, so that it means success.
    set run_folder [get_property DIRECTORY [get_runs impl_1]]
    file copy -force [exactly_one "hardware handoff" [glob -directory $project_folder \
        $fact(name).gen/sources_1/bd/$fact(block_design)/hw_handoff/$fact(block_design).hwh]] \
        [file join $folder $fact(name).hwh]
    file copy -force [file join $run_folder $fact(block_design)_wrapper.bit] [file join $folder $fact(name).bit]
    close_project
    puts "bitstream: [file join $folder $fact(name).bit]"
}
