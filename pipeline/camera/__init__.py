"""What a pixel is: its class, its ray, its file."""
