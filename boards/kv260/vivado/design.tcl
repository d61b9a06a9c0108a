# The block design: processing system, AXI DMA, the IP, fan. One clock, pl_clk0, for everything.
#
#   HPM0 ── control ──┬── cmfpga/s_axi            DMA MM2S ── to_core ── cmfpga/s_axis
#                     └── dma/S_AXI_LITE          cmfpga/m_axis ── from_core ── DMA S2MM
#   HP0 ─── memory ───── dma/M_AXI_*              cmfpga/irq ── pl_ps_irq0[0]

proc create_processing_system {} {
    global fact
    set ps [create_bd_cell -type ip -vlnv [newest_ip xilinx.com:ip:zynq_ultra_ps_e] ps]
    apply_bd_automation -rule xilinx.com:bd_rule:zynq_ultra_ps_e -config {apply_board_preset "1"} $ps
    set settings [list \
        CONFIG.PSU__FPGA_PL0_ENABLE 1 \
        CONFIG.PSU__CRL_APB__PL0_REF_CTRL__FREQMHZ $fact(clock_mhz) \
        $fact(control_use) 1 \
        $fact(control_width_parameter) $fact(control_width) \
        $fact(memory_use) 1 \
        $fact(memory_width_parameter) $fact(memory_width) \
        CONFIG.PSU__USE__IRQ0 1 \
        CONFIG.PSU__TTC0__PERIPHERAL__ENABLE 1 \
        CONFIG.PSU__TTC0__WAVEOUT__ENABLE 1 \
        CONFIG.PSU__TTC0__WAVEOUT__IO EMIO]
    foreach port $fact(control_unused) {
        lappend settings $port 0
    }
    set_property -dict $settings $ps
}

proc create_cells {} {
    global fact
    create_bd_cell -type ip -vlnv [newest_ip xilinx.com:ip:proc_sys_reset] reset
    create_bd_cell -type ip -vlnv $fact(vlnv) cmfpga

    set control [create_bd_cell -type ip -vlnv [newest_ip xilinx.com:ip:smartconnect] control]
    set_property -dict {CONFIG.NUM_SI 1 CONFIG.NUM_MI 2} $control
    set memory [create_bd_cell -type ip -vlnv [newest_ip xilinx.com:ip:smartconnect] memory]
    set_property -dict {CONFIG.NUM_SI 2 CONFIG.NUM_MI 1} $memory

    set dma [create_bd_cell -type ip -vlnv [newest_ip xilinx.com:ip:axi_dma] dma]
    set_property -dict [list \
        CONFIG.c_include_sg 0 \
        CONFIG.c_sg_include_stscntrl_strm 0 \
        CONFIG.c_sg_length_width $fact(dma_length_width) \
        CONFIG.c_addr_width $fact(dma_address_width) \
        CONFIG.c_include_mm2s 1 \
        CONFIG.c_m_axi_mm2s_data_width $fact(dma_data_width) \
        CONFIG.c_m_axis_mm2s_tdata_width $fact(dma_data_width) \
        CONFIG.c_mm2s_burst_size $fact(dma_burst) \
        CONFIG.c_include_s2mm 1 \
        CONFIG.c_m_axi_s2mm_data_width $fact(dma_data_width) \
        CONFIG.c_s_axis_s2mm_tdata_width $fact(dma_data_width) \
        CONFIG.c_s2mm_burst_size $fact(dma_burst)] $dma

    # The DMA has no TUSER and the IP has one, as the camera's chain wants it; wires, no logic.
    create_subset_converter to_core 0 $fact(stream_user_width)
    create_subset_converter from_core $fact(stream_user_width) 0
}

proc create_subset_converter {name user_in user_out} {
    global fact
    set bytes $fact(stream_bytes)
    set cell [create_bd_cell -type ip -vlnv [newest_ip xilinx.com:ip:axis_subset_converter] $name]
    set_property -dict [list \
        CONFIG.S_TDATA_NUM_BYTES $bytes CONFIG.M_TDATA_NUM_BYTES $bytes \
        CONFIG.S_TUSER_WIDTH $user_in CONFIG.M_TUSER_WIDTH $user_out \
        CONFIG.S_HAS_TREADY 1 CONFIG.M_HAS_TREADY 1 \
        CONFIG.S_HAS_TKEEP 1 CONFIG.M_HAS_TKEEP 1 \
        CONFIG.S_HAS_TLAST 1 CONFIG.M_HAS_TLAST 1 \
        CONFIG.TDATA_REMAP "tdata\[[expr {8 * $bytes - 1}]:0\]" \
        CONFIG.TKEEP_REMAP "tkeep\[[expr {$bytes - 1}]:0\]" \
        CONFIG.TLAST_REMAP {tlast[0]} \
        CONFIG.TUSER_REMAP {1'b0}] $cell
}

# One bit of the timer's waves. The slice became an inline cell in 2025.x: try the old one, then the new one.
proc create_fan {} {
    global fact
    if {[llength [get_ipdefs xilinx.com:ip:xlslice:*]]} {
        set slice [create_bd_cell -type ip -vlnv [newest_ip xilinx.com:ip:xlslice] fan]
    } else {
        set slice [create_bd_cell -type inline_hdl -vlnv [newest_ip xilinx.com:inline_hdl:ilslice] fan]
    }
    set bit $fact(fan_timer_bit)
    set_property -dict [list CONFIG.DIN_WIDTH 3 CONFIG.DIN_FROM $bit CONFIG.DIN_TO $bit] $slice
    create_bd_port -dir O $fact(fan_port)
    connect_bd_net [get_bd_pins ps/emio_ttc0_wave_o] [get_bd_pins fan/Din]
    connect_bd_net [get_bd_pins fan/Dout] [get_bd_ports $fact(fan_port)]
}

proc connect_cells {} {
    global fact
    foreach {from to} [list \
        ps/$fact(control_port) control/S00_AXI \
        control/M00_AXI cmfpga/s_axi \
        control/M01_AXI dma/S_AXI_LITE \
        dma/M_AXI_MM2S memory/S00_AXI \
        dma/M_AXI_S2MM memory/S01_AXI \
        memory/M00_AXI ps/$fact(memory_port) \
        dma/M_AXIS_MM2S to_core/S_AXIS \
        to_core/M_AXIS cmfpga/s_axis \
        cmfpga/m_axis from_core/S_AXIS \
        from_core/M_AXIS dma/S_AXIS_S2MM \
    ] {
        connect_bd_intf_net [get_bd_intf_pins $from] [get_bd_intf_pins $to]
    }

    foreach pin [list reset/slowest_sync_clk ps/$fact(control_clock_pin) ps/$fact(memory_clock_pin) \
        control/aclk memory/aclk cmfpga/aclk to_core/aclk from_core/aclk \
        dma/s_axi_lite_aclk dma/m_axi_mm2s_aclk dma/m_axi_s2mm_aclk] {
        connect_bd_net [get_bd_pins ps/pl_clk0] [get_bd_pins $pin]
    }

    connect_bd_net [get_bd_pins ps/pl_resetn0] [get_bd_pins reset/ext_reset_in]
    foreach pin {control/aresetn memory/aresetn} {
        connect_bd_net [get_bd_pins reset/interconnect_aresetn] [get_bd_pins $pin]
    }
    foreach pin {cmfpga/aresetn dma/axi_resetn to_core/aresetn from_core/aresetn} {
        connect_bd_net [get_bd_pins reset/peripheral_aresetn] [get_bd_pins $pin]
    }

    # Straight to the first line, without an interrupt controller: PYNQ and UIO wait on it alike. The DMA is polled.
    connect_bd_net [get_bd_pins cmfpga/irq] [get_bd_pins ps/pl_ps_irq0]
}

proc assign_addresses {} {
    global fact
    set cpu [get_bd_addr_spaces ps/Data]
    # The segment's own name is Vivado's choice (reg0, Reg); the interface's is ours.
    assign_bd_address -offset $fact(cmfpga_address) -range $fact(cmfpga_size) -target_address_space $cpu \
        [exactly_one "segment of cmfpga" [get_bd_addr_segs cmfpga/s_axi/*]]
    assign_bd_address -offset $fact(dma_address) -range $fact(dma_size) -target_address_space $cpu \
        [exactly_one "segment of the DMA" [get_bd_addr_segs dma/S_AXI_LITE/*]]

    foreach channel {MM2S S2MM} {
        set space [get_bd_addr_spaces dma/Data_$channel]
        foreach half {low high} {
            assign_bd_address -offset $fact(ddr_${half}_offset) -range $fact(ddr_${half}_size) \
                -target_address_space $space \
                [get_bd_addr_segs ps/$fact(memory_segments)_DDR_[string toupper $half]]
        }
        foreach segment $fact(memory_excluded) {
            exclude_bd_addr_seg -target_address_space $space [get_bd_addr_segs ps/$fact(memory_segments)_$segment]
        }
    }
}

proc create_block_design {} {
    global fact
    create_bd_design $fact(block_design)
    create_processing_system
    create_cells
    connect_cells
    create_fan
    assign_addresses
    regenerate_bd_layout
    validate_bd_design
    save_bd_design
}
