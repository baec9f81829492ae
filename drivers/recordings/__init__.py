"""Films, image folders and logs, played as a camera."""
