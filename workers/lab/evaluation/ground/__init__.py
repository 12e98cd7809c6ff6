"""Ground evaluation: ground points and heights against truth, with floors."""
