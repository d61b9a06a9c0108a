"""The core behind AXI ports: event words in, result packets out, registers."""
