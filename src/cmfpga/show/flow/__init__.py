"""Dense flow as pictures, and as a page for the browser."""
