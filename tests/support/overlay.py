"""A hardware hand-off (.hwh), as Vivado writes it for PYNQ: of the parts that PYNQ's driver needs, made by hand.

What Vivado really writes was never seen by us; the structure is that of the files in pynqmetadata's tests.
"""

from xml.etree import ElementTree

from cmfpga.boards import DEFAULT


def _module(parent, name, vlnv, module, *, parameters=(), buses=(), registers=()):
    node = ElementTree.SubElement(
        parent, "MODULE", FULLNAME=f"/{name}", HWVERSION=vlnv.split(":")[-1], INSTANCE=name, IPTYPE="PERIPHERAL",
        IS_ENABLE="1", MODCLASS="PERIPHERAL", MODTYPE=module, VLNV=vlnv, COREREVISION="1",
    )  # fmt: skip
    ElementTree.SubElement(node, "DOCUMENTS")
    blocks = ElementTree.SubElement(node, "ADDRESSBLOCKS")
    if registers:
        block = ElementTree.SubElement(
            blocks, "ADDRESSBLOCK", ACCESS="read-write", INTERFACE="s_axi", NAME="reg0", RANGE="65536", USAGE="register"
        )
        _registers(ElementTree.SubElement(block, "REGISTERS"), registers)
    parameter_list = ElementTree.SubElement(node, "PARAMETERS")
    for key, value in dict(parameters).items():
        ElementTree.SubElement(parameter_list, "PARAMETER", NAME=key, VALUE=str(value))
    ElementTree.SubElement(node, "PORTS")
    interfaces = ElementTree.SubElement(node, "BUSINTERFACES")
    for bus, kind, direction, net in buses:
        bus_node = ElementTree.SubElement(
            interfaces, "BUSINTERFACE", BUSNAME=net, DATAWIDTH="32", NAME=bus, TYPE=direction,
            VLNV=f"xilinx.com:interface:{kind}:1.0",
        )  # fmt: skip
        ElementTree.SubElement(bus_node, "PORTMAPS")
    return node


def _registers(parent, registers):
    for register in registers:
        node = ElementTree.SubElement(parent, "REGISTER", NAME=register.name)
        _properties(node, DESCRIPTION=register.doc, ADDRESS_OFFSET=register.offset, SIZE=32, ACCESS="read-write")
        fields = ElementTree.SubElement(node, "FIELDS")
        for f in register.fields:
            field = ElementTree.SubElement(fields, "FIELD", NAME=f.name)
            access = "read-only" if f.access in ("constant", "status") else "read-write"
            _properties(field, DESCRIPTION=f.doc, ACCESS=access, BIT_OFFSET=f.lsb, BIT_WIDTH=f.width)


def _properties(node, **properties):
    for key, value in properties.items():
        ElementTree.SubElement(node, "PROPERTY", NAME=key, VALUE=str(value))


def write_hwh(path, *, vlnv, registers_address, dma_address, registers):
    """Write the hand-off of a design with the accelerator as ``cmfpga``, and ``dma``."""
    root = ElementTree.Element("EDKSYSTEM", EDWVERSION="1.2", TIMESTAMP="", VIVADOVERSION="2022.2")
    ElementTree.SubElement(
        root, "SYSTEMINFO", ARCH="zynquplus", DEVICE="xck26", NAME="cmfpga_bd", PACKAGE="sfvc784", SPEEDGRADE="-2LV"
    )
    ElementTree.SubElement(root, "EXTERNALPORTS")
    ElementTree.SubElement(root, "EXTERNALINTERFACES")
    modules = ElementTree.SubElement(root, "MODULES")
    processor = _module(
        modules, "ps", "xilinx.com:ip:zynq_ultra_ps_e:3.5", "zynq_ultra_ps_e",
        buses=[("M_AXI_HPM0_FPD", "aximm", "MASTER", "control")],
        parameters={
            name: value
            for k in range(4)
            for name, value in (
                (f"PSU__FPGA_PL{k}_ENABLE", int(k == 0)), (f"PSU__CRL_APB__PL{k}_REF_CTRL__SRCSEL", "IOPLL"),
                (f"PSU__CRL_APB__PL{k}_REF_CTRL__ACT_FREQMHZ", "199.998"),
                (f"PSU__CRL_APB__PL{k}_REF_CTRL__DIVISOR0", 5), (f"PSU__CRL_APB__PL{k}_REF_CTRL__DIVISOR1", 1),
            )
        },
    )  # fmt: skip
    memory = ElementTree.SubElement(processor, "MEMORYMAP")
    for name, bus, base in (("cmfpga", "s_axi", registers_address), ("dma", "S_AXI_LITE", dma_address)):
        ElementTree.SubElement(
            memory, "MEMRANGE", ADDRESSBLOCK="reg0", BASENAME="C_BASEADDR", BASEVALUE=f"{base:#010X}",
            HIGHNAME="C_HIGHADDR", HIGHVALUE=f"{base + 0xFFFF:#010X}", INSTANCE=name, IS_DATA="TRUE",
            IS_INSTRUCTION="FALSE", MASTERBUSINTERFACE="M_AXI_HPM0_FPD", MEMTYPE="REGISTER", SLAVEBUSINTERFACE=bus,
        )  # fmt: skip
    ElementTree.SubElement(processor, "PERIPHERALS")
    _module(modules, "cmfpga", vlnv, "cmfpga", buses=[("s_axi", "aximm", "SLAVE", "control")], registers=registers)
    _module(
        modules, "dma", "xilinx.com:ip:axi_dma:7.1", "axi_dma",
        buses=[("S_AXI_LITE", "aximm", "SLAVE", "control")],
        parameters={
            "c_include_sg": 0, "c_sg_length_width": DEFAULT.dma_length_bits, "c_include_mm2s": 1, "c_include_s2mm": 1,
            "c_m_axi_mm2s_data_width": 64, "c_m_axi_s2mm_data_width": 64, "c_micro_dma": 0,
        },
    )  # fmt: skip
    ElementTree.ElementTree(root).write(path)
