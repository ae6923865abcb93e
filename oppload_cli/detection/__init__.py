"""Alarms and places of looming objects, computed from responses."""
