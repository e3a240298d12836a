"""The same flow with buttons: a page that a server on this machine shows; an extra."""
