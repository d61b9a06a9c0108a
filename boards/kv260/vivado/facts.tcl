# Generated from boards/kv260/board.toml by boards/kv260/facts.py; do not edit.
set fact(name)                    cmfpga
set fact(top)                     cmfpga_kv260
set fact(block_design)            cmfpga_bd
set fact(vivado_minimum)          2022.2
set fact(part)                    xck26-sfvc784-2LV-c
set fact(board_part)              xilinx.com:kv260_som:part0:1.4
set fact(board_part_pattern)      *:kv260_som:*
set fact(carrier_connector)       som240_1_connector
set fact(carrier)                 xilinx.com:kv260_carrier:som240_1_connector:1.3
set fact(fan_port)                fan_en_b
set fact(fan_timer_bit)           2
set fact(clock_mhz)               200
set fact(clock_hertz)             199998000
set fact(vlnv)                    cmfpga.org:ip:cmfpga:1.0
set fact(ip_vendor)               cmfpga.org
set fact(ip_library)              ip
set fact(ip_name)                 cmfpga
set fact(ip_version)              1.0
set fact(ip_interfaces)           {aclk xilinx.com:signal:clock:1.0 slave aresetn xilinx.com:signal:reset:1.0 slave s_axi xilinx.com:interface:aximm:1.0 slave s_axis xilinx.com:interface:axis:1.0 slave m_axis xilinx.com:interface:axis:1.0 master irq xilinx.com:signal:interrupt:1.0 master}
set fact(stream_bytes)            8
set fact(stream_user_width)       1
set fact(control_port)            M_AXI_HPM0_FPD
set fact(control_use)             CONFIG.PSU__USE__M_AXI_GP0
set fact(control_width_parameter) CONFIG.PSU__MAXIGP0__DATA_WIDTH
set fact(control_width)           32
set fact(control_clock_pin)       maxihpm0_fpd_aclk
set fact(control_unused)          {CONFIG.PSU__USE__M_AXI_GP1 CONFIG.PSU__USE__M_AXI_GP2}
set fact(cmfpga_address)          0xa0000000
set fact(cmfpga_size)             0x10000
set fact(dma_address)             0xa0010000
set fact(dma_size)                0x10000
set fact(memory_port)             S_AXI_HP0_FPD
set fact(memory_use)              CONFIG.PSU__USE__S_AXI_GP2
set fact(memory_width_parameter)  CONFIG.PSU__SAXIGP2__DATA_WIDTH
set fact(memory_width)            128
set fact(memory_clock_pin)        saxihp0_fpd_aclk
set fact(memory_segments)         SAXIGP2/HP0
set fact(memory_excluded)         {QSPI LPS_OCM}
set fact(ddr_low_offset)          0x0
set fact(ddr_low_size)            0x80000000
set fact(ddr_high_offset)         0x800000000
set fact(ddr_high_size)           0x80000000
set fact(dma_length_width)        26
set fact(dma_address_width)       40
set fact(dma_burst)               64
set fact(dma_data_width)          64
