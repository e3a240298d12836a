"""The app's server in a thread of this process."""

import asyncio
import contextlib
import threading


@contextlib.contextmanager
def serving(**options):
    """The address of a server, which ends with the context."""
    from stepax.app._server import App

    found, ready = [], threading.Event()

    def serve():
        asyncio.set_event_loop(asyncio.new_event_loop())
        found.append(App(**options))
        ready.set()
        found[0].run()

    thread = threading.Thread(target=serve)
    thread.start()
    assert ready.wait(60)
    try:
        yield found[0].address
    finally:
        found[0].stop()
        thread.join(20)
