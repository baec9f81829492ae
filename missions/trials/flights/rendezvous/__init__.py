"""The trial of the rendezvous from bad positions, in wind."""
