"""From responses to alarms and places."""
