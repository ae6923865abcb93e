"""Every synthetic figure of the OppLoD paper, made and judged."""
