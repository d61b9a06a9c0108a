"""What stands between a shell and a serial line: bytes, frames, and the bridge that makes register accesses of them."""
