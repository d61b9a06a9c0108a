"""Following objects through a recording: batches in order, and what is kept of them."""
