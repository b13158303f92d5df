"""Waiting for a page, which allows no eval, so that Playwright's own way cannot be used."""

import time

TIMEOUT = 15.0


def wait_until(page, expression, argument=None):
    """Until a JavaScript expression or function is true on the page."""
    end = time.monotonic() + TIMEOUT
    while not page.evaluate(expression, argument):
        assert time.monotonic() < end, expression
        page.wait_for_timeout(20)
