"""The replay page: one road's trajectory, encoded for the browser, and the page that shows it."""
