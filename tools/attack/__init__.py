"""An attack on the real command with hostile input; see ``tools/attack/campaign.py``."""
