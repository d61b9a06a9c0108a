"""Each block of the RTL against its integer model."""
