"""The server: on this machine alone, for its own pages alone, and the command that starts it."""

import asyncio
import re
import urllib.request

import pytest
from tests.app.serving import serving

from stepax._cli import run


pytest.importorskip("bokeh")


@pytest.fixture(scope="module")
def address():
    with serving(warm=False) as address:
        yield address


def test_the_page(address):
    with urllib.request.urlopen(address) as answer:
        page = answer.read().decode()
    assert "<title>stepax</title>" in page and 'content="width=device-width' in page
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert sources and not [x for x in sources if not x.startswith(("static/", "/static", "data:"))]


def test_a_session(address):
    from bokeh.client import pull_session

    session = pull_session(url=address)
    names = {model.name for model in session.document.models if model.name}
    assert {"actions", "results"} <= names
    session.close()


@pytest.mark.parametrize(("origin", "code"), [("http://evil.example", 403), (None, 101)])
def test_other_sites_cannot_drive_it(address, origin, code):
    from bokeh.util.token import generate_jwt_token, generate_session_id
    from tornado.httpclient import HTTPClientError, HTTPRequest
    from tornado.websocket import websocket_connect

    token = generate_jwt_token(generate_session_id())
    headers = {"Origin": origin or address.rstrip("/"), "Sec-WebSocket-Protocol": f"bokeh, {token}"}
    url = address.replace("http", "ws") + "ws"

    async def connect():
        try:
            socket = await websocket_connect(HTTPRequest(url, headers=headers))
        except HTTPClientError as error:
            return error.code
        socket.close()
        await asyncio.sleep(0.1)
        return 101

    assert asyncio.run(connect()) == code


def test_it_listens_on_this_machine_alone(monkeypatch):
    from bokeh.server.server import Server

    from stepax.app import _server

    asked = {}

    class Watched(Server):
        def __init__(self, *args, **kwargs):
            asked.update(kwargs)
            raise OSError("no more is needed")

    monkeypatch.setattr("bokeh.server.server.Server", Watched)
    with pytest.raises(OSError, match="no more"):
        _server.App(warm=False)
    assert asked["address"] == "127.0.0.1" and asked["websocket_max_message_size"] > 200e6 * 4 / 3


def test_the_command(capsys, monkeypatch, tmp_path):
    assert run(["app", str(tmp_path / "none.csv"), "--no-browser"]) == 2
    assert "There is no file" in capsys.readouterr().err
    monkeypatch.setitem(__import__("sys").modules, "bokeh.application", None)
    assert run(["app", "--no-browser"]) == 2
    assert 'pip install "stepax[app]"' in capsys.readouterr().err
