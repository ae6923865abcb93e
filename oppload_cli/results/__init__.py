"""Results: writes and reads tables, sidecars, detections and alarms."""
