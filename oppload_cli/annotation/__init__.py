"""Annotated videos: the frames with boxes, and below them the responses of the detectors."""
