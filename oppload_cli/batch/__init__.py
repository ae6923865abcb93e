"""Many inputs: the plan, and running it in processes of this machine or on a cluster."""
