"""Truth beside a log, and the classes that it is counted in."""
