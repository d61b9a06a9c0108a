"""A strict stand-in for Vivado: which commands the scripts may use, and what some leave behind."""
