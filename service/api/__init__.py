"""Messages and handlers of everything that is asked over the bus."""
