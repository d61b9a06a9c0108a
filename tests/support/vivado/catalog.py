"""What the Vivado scripts may say: commands, properties, their order, and IPs. Data; ``vivado.py`` checks against it.

Names and ranges are those of AMD's manuals (UG835 commands, UG994 block designs, PG021 AXI DMA, PG164 reset, PG247
SmartConnect, PG085 AXI4-Stream, PG201 and UG1085 processing system), cut to what the scripts use.
"""

#: Usage by command. ``-flag``, ``-option=PATTERN`` (any value if empty), ``!`` in front: required. Positional words:
#: ``name``, ``=PATTERN``, ``<kind|kind>`` one object of these kinds, with ``...`` behind it any number of them. Result:
#: ``=> kind`` objects by pattern (``?``: or none), ``=> kind:`` the only one, ``=> +kind`` a new one.
COMMANDS = {
    "version": "-short", "create_project": "-force !-part=xck26-sfvc784-2LV-c name folder", "close_project": "",
    "current_project": "=> project:", "current_fileset": "=> fileset:", "get_files": "pattern => file",
    "get_runs": "pattern => run", "add_files": "-norecurse -fileset=sources_1|constrs_1 files",
    "update_compile_order": "!-fileset=sources_1", "set_property": "-dict= words...", "get_property": "name object",
    "get_board_parts": "-quiet !-latest_file_version pattern", "update_ip_catalog": "", "get_ipdefs": "pattern",
    "create_bd_design": "name", "create_bd_cell": "!-type=ip|inline_hdl !-vlnv= name => +cell",
    "apply_bd_automation": r"!-rule=xilinx.com:bd_rule:zynq_ultra_ps_e !-config=apply_board_preset\s\"1\" <cell>",
    "create_bd_port": "!-dir=O name => +port", "get_bd_ports": "pattern => port", "get_bd_pins": "pattern => pin",
    "get_bd_intf_pins": "pattern => intf_pin", "get_bd_addr_spaces": "pattern => space",
    "get_bd_addr_segs": "pattern => segment", "connect_bd_net": "<pin|port>...",
    "connect_bd_intf_net": "<intf_pin> <intf_pin>",
    "assign_bd_address": "!-offset= !-range= !-target_address_space=<space> <segment>",
    "exclude_bd_addr_seg": "!-target_address_space=<space> <segment>", "regenerate_bd_layout": "",
    "validate_bd_design": "", "save_bd_design": "", "generate_target": "=all <file>",
    "make_wrapper": "!-files=<file> !-top", "launch_runs": r"-to_step=write_bitstream !-jobs=[1-9]\d* <run>",
    "wait_on_run": "<run>", "open_run": "=impl_1", "write_hw_platform": "!-fixed !-include_bit -force !-file=",
    "write_checkpoint": "-force file", "read_verilog": "file", "read_xdc": "!-mode=out_of_context file",
    "synth_design": "!-mode=out_of_context !-top= !-part=xck26-sfvc784-2LV-c", "opt_design": "", "place_design": "",
    "phys_opt_design": "", "route_design": "",
    "report_timing_summary": r"!-delay_type=min_max -max_paths=\d+ -report_unconstrained -file= -return_string",
    "report_utilization": "-hierarchical -file= -return_string", "report_power": "-file= -return_string",
    "report_clock_interaction": "!-delay_type=min_max -no_header -file= -return_string",
    "report_cdc": "-no_header -details -severity=Critical -file= -return_string", "report_bus_skew": "-file=",
    "report_methodology": "-file=", "report_drc": "-file=", "report_ram_utilization": "-file=",
    "get_ports": "pattern => port", "current_design": "=> design:", "create_clock": r"!-name= !-period=[\d.]+ <port>",
    "ipx::package_project": "!-root_dir= !-vendor= !-library= !-taxonomy=/UserIP !-import_files !-set_current=true "
                            "-force",
    "ipx::current_core": "=> core:", "ipx::get_bus_interfaces": "!-of_objects=<core> pattern => interface?",
    "ipx::get_bus_parameters": "!-of_objects=<interface> pattern => parameter?",
    "ipx::get_memory_maps": "!-of_objects=<core> pattern => map?", "ipx::add_register": "name <block> => +register",
    "ipx::get_address_blocks": "!-of_objects=<map> pattern => block?", "ipx::add_field": "name <register> => +field",
    "ipx::create_xgui_files": "<core>", "ipx::update_checksums": "<core>", "ipx::check_integrity": "<core>",
    "ipx::save_core": "<core>",
}  # fmt: skip

#: What must have been done before a command, or before a property is set; ``a|b`` is one of the two.
AFTER = {
    "current_project": "create_project", "current_fileset": "create_project", "close_project": "create_project",
    "get_ipdefs": "create_project", "update_ip_catalog": "ip_repo_paths", "create_bd_design": "create_project",
    "create_bd_cell": "create_bd_design", "board_connections": "board_part", "PSU": "apply_bd_automation",
    "apply_bd_automation": "board_connections", "generate_target": "validate_bd_design save_bd_design",
    "make_wrapper": "generate_target", "launch_runs": "validate_bd_design make_wrapper update_compile_order",
    "impl_1": "synth_1", "open_run": "impl_1", "get_ports": "XDC", "current_design": "XDC",
    "create_clock": "XDC read_xdc", "read_xdc": "read_verilog", "synth_design": "read_xdc",
    "opt_design": "synth_design", "place_design": "opt_design", "phys_opt_design": "place_design",
    "route_design": "phys_opt_design", "write_checkpoint": "route_design", "write_hw_platform": "open_run",
    "report": "open_run|route_design", "ipx::package_project": "top update_compile_order",
    "ipx::update_checksums": "ipx::create_xgui_files", "ipx::check_integrity": "ipx::update_checksums",
    "ipx::save_core": "name version range ipx::check_integrity", "top": "add_files",
}  # fmt: skip

#: After these a design must be validated and saved anew.
CHANGES = {"create_bd_cell", "create_bd_port", "connect_bd_net", "connect_bd_intf_net", "assign_bd_address",
           "exclude_bd_addr_seg", "CONFIG"}  # fmt: skip

#: Properties that may be set, by kind of object, each with the pattern of its values.
PROPERTIES = {
    "project": {"board_part": ".+", "ip_repo_paths": ".+",
                "board_connections": "som240_1_connector xilinx.com:kv260_carrier:som240_1_connector:1.3"},
    "fileset": {"top": r"\w+"},
    "port": {"PACKAGE_PIN": r"[A-H]\d+", "IOSTANDARD": "LVCMOS33|LVCMOS18", "SLEW": "SLOW|MEDIUM|FAST",
             "DRIVE": "4|8|12"},
    "design": {"BITSTREAM.GENERAL.COMPRESS": "TRUE|FALSE", "BITSTREAM.CONFIG.OVERTEMPSHUTDOWN": "ENABLE|DISABLE"},
    "core": dict.fromkeys(("name", "version", "display_name", "description"), ".+")
    | {"supported_families": "", "auto_family_support_level": "level_2"},
    "block": {"range": r"\d+"},
    "register": {"description": ".*", "reset_value": "0x[0-9a-fA-F]+"}
    | {"address_offset": "0x[0-9a-fA-F]+", "size": "32", "access": "read-only|write-only|read-write"},
    "field": {"description": ".*", "modified_write_value": ".+", "read_action": ".+"}
    | {"bit_offset": r"\d+", "bit_width": r"\d+", "access": "read-only|write-only|read-write"},
}  # fmt: skip

# An IP is its parameters, ``{name: (default, pattern or range)}``, and lines of what it has; numbers are expressions of
# the parameters, ``if`` and ``for`` too: pin NAME I|O KIND WIDTH (a pin of a kind with ``?`` may stay open, an output
# with ``!`` may not) · axi NAME master CLOCK SPACE LOW SIZE · axi NAME slave CLOCK · axis NAME MODE CLOCK BYTES USER
# KEEP LAST · segment NAME INTERFACE SIZE OFFSET (-1: free) · through - (what its slaves take reaches its masters) ·
# must NAME EXPRESSION (without blanks).
SWITCH, WIDTHS, BURSTS = "[01]", "32|64|128|256|512|1024", "2|4|8|16|32|64|128|256"
MASTERS = (
    ("M_AXI_HPM0_FPD", "0xA0000000 1<<28"),
    ("M_AXI_HPM1_FPD", "0xB0000000 1<<28"),
    ("M_AXI_HPM0_LPD", "0x80000000 1<<29"),
)
SLAVES = ("HPC0", "HPC1", "HP0", "HP1", "HP2", "HP3")
DDR = (
    ("DDR_LOW", 1 << 31, 0),
    ("DDR_HIGH", 32 << 30, 8 << 32),
    ("QSPI", 1 << 29, 3 << 30),
    ("LPS_OCM", 1 << 24, 255 << 24),
)

PROCESSING_SYSTEM = (
    {"PSU__FPGA_PL0_ENABLE": ("1", SWITCH), "PSU__CRL_APB__PL0_REF_CTRL__FREQMHZ": ("100", range(1, 401)),
     "PSU__USE__IRQ0": ("0", SWITCH), "PSU__TTC0__PERIPHERAL__ENABLE": ("0", SWITCH),
     "PSU__TTC0__WAVEOUT__ENABLE": ("0", SWITCH), "PSU__TTC0__WAVEOUT__IO": ("", "EMIO"),
     **{f"PSU__USE__M_AXI_GP{n}": (str(int(n < 2)), SWITCH) for n in range(3)},
     **{f"PSU__USE__S_AXI_GP{n}": ("0", SWITCH) for n in range(6)},
     **{f"PSU__{side}AXIGP{n}__DATA_WIDTH": ("128", "32|64|128") for side in "MS" for n in range(6)}},
    ["pin pl_resetn0 O rst_n 1", "pin pl_clk0 O clk 1 if PSU__FPGA_PL0_ENABLE",
     "pin pl_ps_irq0 I irq? 1 if PSU__USE__IRQ0",
     "pin emio_ttc0_wave_o O data 3 if PSU__TTC0__PERIPHERAL__ENABLE and PSU__TTC0__WAVEOUT__ENABLE and "
     "PSU__TTC0__WAVEOUT__IO == 'EMIO'"]
    + [line + f" if PSU__USE__M_AXI_GP{n}" for n, (name, window) in enumerate(MASTERS) for line in (
        f"pin {name.replace('_', '', 2).lower()}_aclk I clk 1",
        f"axi {name} master {name.replace('_', '', 2).lower()}_aclk Data {window}")]
    + [line + f" if PSU__USE__S_AXI_GP{n}" for n, name in enumerate(SLAVES) for line in (
        f"pin saxi{name.lower()}_fpd_aclk I clk 1", f"axi S_AXI_{name}_FPD slave saxi{name.lower()}_fpd_aclk",
        *(f"segment SAXIGP{n}/{name}_{part} S_AXI_{name}_FPD {size} {low}" for part, size, low in DDR))],
)  # fmt: skip
SLICE = (
    {"DIN_WIDTH": ("32", range(2, 4097)), "DIN_FROM": ("0", range(4096)), "DIN_TO": ("0", range(4096))},
    ["must slice DIN_WIDTH>DIN_FROM>=DIN_TO", "pin Din I data DIN_WIDTH", "pin Dout O data DIN_FROM-DIN_TO+1"],
)
IPS = {
    "xilinx.com:ip:zynq_ultra_ps_e:3.4": PROCESSING_SYSTEM, "xilinx.com:ip:zynq_ultra_ps_e:3.5": PROCESSING_SYSTEM,
    "xilinx.com:ip:xlslice:1.0": SLICE, "xilinx.com:inline_hdl:ilslice:1.0": SLICE,
    "xilinx.com:ip:proc_sys_reset:5.0": ({}, [
        "pin slowest_sync_clk I clk 1", "pin ext_reset_in I rst_n 1", "pin aux_reset_in I rst_n? 1",
        "pin dcm_locked I data? 1", "pin peripheral_aresetn O rst_n 1", "pin interconnect_aresetn O rst_n 1",
        "pin peripheral_reset O rst 1"]),
    "xilinx.com:ip:smartconnect:1.0": (
        {"NUM_SI": ("1", range(1, 17)), "NUM_MI": ("1", range(1, 17))},
        ["pin aclk I clk 1", "pin aresetn I rst_n 1", "through -", "axi S{:02}_AXI slave aclk for NUM_SI",
         "axi M{:02}_AXI master aclk for NUM_MI"]),
    "xilinx.com:ip:axi_dma:7.1": (
        {"c_include_sg": ("1", SWITCH), "c_sg_include_stscntrl_strm": ("1", SWITCH),
         "c_sg_length_width": ("14", range(8, 27)), "c_addr_width": ("32", range(32, 65)),
         "c_include_mm2s": ("1", SWITCH), "c_include_s2mm": ("1", SWITCH), "c_mm2s_burst_size": ("16", BURSTS),
         "c_s2mm_burst_size": ("16", BURSTS), "c_m_axi_mm2s_data_width": ("32", WIDTHS),
         "c_m_axi_s2mm_data_width": ("32", WIDTHS), "c_m_axis_mm2s_tdata_width": ("32", "8|16|" + WIDTHS),
         "c_s_axis_s2mm_tdata_width": ("32", "8|16|" + WIDTHS)},
        ["must mm2s c_m_axis_mm2s_tdata_width<=c_m_axi_mm2s_data_width",
         "must s2mm c_s_axis_s2mm_tdata_width<=c_m_axi_s2mm_data_width",
         "pin s_axi_lite_aclk I clk 1", "pin axi_resetn I rst_n 1", "axi S_AXI_LITE slave s_axi_lite_aclk",
         "segment S_AXI_LITE/Reg S_AXI_LITE 0x10000 -1", "pin m_axi_sg_aclk I clk 1 if c_include_sg",
         "axi M_AXI_SG master m_axi_sg_aclk Data_SG 0 1<<c_addr_width if c_include_sg",
         "axis M_AXIS_MM2S master m_axi_mm2s_aclk c_m_axis_mm2s_tdata_width//8 0 1 1 if c_include_mm2s",
         "axis S_AXIS_S2MM slave m_axi_s2mm_aclk c_s_axis_s2mm_tdata_width//8 0 1 1 if c_include_s2mm"]
        + [line + f" if c_include_{low}" for low in ("mm2s", "s2mm") for line in (
            f"pin m_axi_{low}_aclk I clk 1", f"pin {low}_introut O irq 1", f"pin {low}_prmry_reset_out_n O rst_n 1",
            f"axi M_AXI_{low.upper()} master m_axi_{low}_aclk Data_{low.upper()} 0 1<<c_addr_width")]),
    "xilinx.com:ip:axis_subset_converter:1.1": (
        {f"{side}_{name}": (default, allowed) for side in "SM" for name, default, allowed in (
            ("TDATA_NUM_BYTES", "1", range(513)), ("TUSER_WIDTH", "0", range(4097)), ("HAS_TREADY", "1", SWITCH),
            ("HAS_TKEEP", "0", SWITCH), ("HAS_TLAST", "0", SWITCH))}
        | {f"T{name}_REMAP": ("", ".*") for name in ("DATA", "USER", "KEEP", "LAST")},
        ["pin aclk I clk 1", "pin aresetn I rst_n 1", "must bytes M_TDATA_NUM_BYTES<=S_TDATA_NUM_BYTES",
         "must tdata TDATA_REMAP==f'tdata[{8*M_TDATA_NUM_BYTES-1}:0]'or(not(TDATA_REMAP))",
         "must tkeep TKEEP_REMAP==f'tkeep[{M_TDATA_NUM_BYTES-1}:0]'or(not(TKEEP_REMAP))"]
        + [f"axis {side}_AXIS {mode} aclk {side}_TDATA_NUM_BYTES {side}_TUSER_WIDTH {side}_HAS_TKEEP {side}_HAS_TLAST"
           for side, mode in (("S", "slave"), ("M", "master"))]),
}  # fmt: skip
