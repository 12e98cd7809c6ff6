"""Messages and handlers of requests over the bus."""
