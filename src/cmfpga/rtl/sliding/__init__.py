"""Windows that slide: blocks by which events stay for many evaluations. No preset has them yet."""
