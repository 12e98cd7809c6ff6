"""The REST API, in the process and extra of the review page: the verbs of the bus over HTTP."""
