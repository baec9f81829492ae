"""MAVLink as bytes: ports, frames, signatures, and whom a packet is from."""
