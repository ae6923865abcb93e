"""Annotated videos: the frames with boxes, and below them how the models respond."""
