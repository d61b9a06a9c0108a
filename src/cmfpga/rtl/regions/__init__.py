"""Many regions of one batch: a store of events in bins, a table of regions, and units that iterate side by side."""
