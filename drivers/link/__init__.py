"""The link between the drones: messages as signed packets, over UDP or a serial radio."""
