"""Result files: one way to write them."""
