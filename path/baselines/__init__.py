"""What the method is held against: the target found again in D2's image by how it looks, without any geometry."""
