"""Tests of the driver, on the simulated AXI top."""
