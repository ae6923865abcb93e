"""What happens to a frame before a detector sees it: its time, repeats, pictures in between."""
