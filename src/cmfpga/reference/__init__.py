"""Float and integer references of the accelerator."""
