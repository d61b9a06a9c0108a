# Packages the emitted Verilog as an IP.
#
#   vivado -mode batch -source package_ip.tcl -tclargs VERILOG REGISTERS FOLDER
#
# VERILOG    cmfpga_kv260.v
# REGISTERS  regs.tcl, generated from the register map; defines `cmfpga_registers ADDRESS_BLOCK`
# FOLDER     where the IP goes; FOLDER/component.xml says that it is complete

source [file join [file dirname [info script]] common.tcl]

guarded {
    require_vivado
    if {[llength $argv] != 3} {
        error "expected VERILOG REGISTERS FOLDER, got \"$argv\""
    }
    lassign $argv verilog registers folder
    foreach file [list $verilog $registers] {
        if {![file exists $file]} {
            error "$file does not exist: make rtl"
        }
    }
    file delete -force $folder
    file mkdir $folder
    set folder [file normalize $folder]

    create_project -force package [file join $folder project] -part $fact(part)
    add_files -norecurse [file normalize $verilog]
    set_property top $fact(top) [current_fileset]
    update_compile_order -fileset sources_1

    ipx::package_project -root_dir $folder -vendor $fact(ip_vendor) -library $fact(ip_library) -taxonomy /UserIP \
        -import_files -set_current true -force
    set core [ipx::current_core]
    set_property name $fact(ip_name) $core
    set_property version $fact(ip_version) $core
    set_property display_name "Contrast Maximization for event cameras" $core
    set_property description "Estimates the motion of a region of interest from batches of events" $core
    set_property supported_families {} $core
    set_property auto_family_support_level level_2 $core

    # Vivado infers the interfaces from names and attributes; nothing else may come of it, and nothing less.
    foreach {name bus mode} $fact(ip_interfaces) {
        set interface [exactly_one "interface $name" [ipx::get_bus_interfaces $name -of_objects $core]]
        foreach {property expected} [list bus_type_vlnv $bus interface_mode $mode] {
            set found [get_property $property $interface]
            if {$found ne $expected} {
                error "interface $name: $property is $found, expected $expected"
            }
        }
    }
    set found [llength [ipx::get_bus_interfaces * -of_objects $core]]
    if {$found != [llength $fact(ip_interfaces)] / 3} {
        error "expected [expr {[llength $fact(ip_interfaces)] / 3}] interfaces, Vivado inferred $found"
    }
    set clock [ipx::get_bus_interfaces aclk -of_objects $core]
    foreach {parameter expected} {ASSOCIATED_BUSIF {m_axis s_axi s_axis} ASSOCIATED_RESET aresetn} {
        set object [exactly_one "parameter $parameter of aclk" [ipx::get_bus_parameters $parameter -of_objects $clock]]
        set value [lsort [split [get_property value $object] :]]
        if {$value ne $expected} {
            error "aclk: $parameter is $value, expected $expected"
        }
    }

    # The registers, so that the hardware description names them.
    set map [exactly_one "memory map" [ipx::get_memory_maps * -of_objects $core]]
    set block [exactly_one "address block" [ipx::get_address_blocks * -of_objects $map]]
    set_property range [expr {$fact(cmfpga_size)}] $block
    source $registers
    cmfpga_registers $block

    ipx::create_xgui_files $core
    ipx::update_checksums $core
    ipx::check_integrity $core
    ipx::save_core $core
    close_project
    file delete -force [file join $folder project]
    if {![file exists [file join $folder component.xml]]} {
        error "Vivado wrote no component.xml into $folder"
    }
    puts "IP: $folder"
}
