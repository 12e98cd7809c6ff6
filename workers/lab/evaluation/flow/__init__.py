"""Scene flow evaluation: end-point errors of flows against truth, with floors."""
