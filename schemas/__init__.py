"""The words of the system: what every part may say to another. numpy and pydantic only."""
