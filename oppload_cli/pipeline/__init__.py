"""One input from frames to result files."""
