"""The review page: ranking, verdicts, selections and the dashboard in a browser.

It needs the extra `review`; nothing else of the service imports it.
"""
