"""Runtime helpers of every process: logging, retries, HTTP."""
