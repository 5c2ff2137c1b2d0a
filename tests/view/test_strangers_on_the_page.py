"""What reaches the page from others than the browser that was opened with its address, and messages nobody can use."""

import http.client
import http.server
import json
import math
import threading
import time
from collections import Counter

import numpy as np
import pytest
from page_parts import STOP, until

from longreach.view.control_channel import parse
from longreach.view.player import Player
from longreach.view.teleop import Teleop

pytest.importorskip("viser")
import viser
from msgspec import msgpack
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

VISER = f"viser-v{viser.__version__}"


@pytest.fixture(params=["robot", "recording"])
def shown(request, server, drive, pretender, tmp_path):
    """A page of either kind."""
    if request.param == "robot":
        return Teleop(server, pretender, tmp_path)
    return Player(server, drive)


def websocket(server, path="", origin=None, host=None, **options):
    """A websocket as a page at an origin opens it; its own origin where none is given."""
    home = server.gate.address.replace("http:", "ws:")
    headers = None if host is None else {"Host": host}
    origin = f"http://127.0.0.1:{server.get_port()}" if origin is None else origin or None
    return connect(home + path, origin=origin, additional_headers=headers, compression=None, **options)


def asked(server, path, **headers):
    """The status and headers of the answer to a GET."""
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=10.0)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer.status, answer.headers


def test_a_page_of_another_origin_reaches_neither_viser_nor_the_control_channel(server, shown):
    for path in ("", "control"):
        for origin in ("http://evil.example", "null", f"http://127.0.0.1:{server.get_port() + 1}", ""):
            with pytest.raises(InvalidStatus, match="403"):
                websocket(server, path, origin=origin, subprotocols=[VISER])
    assert server.gate.rejections.counts == {"from another page": 8}
    with websocket(server, subprotocols=[VISER]) as own:
        assert own.recv(timeout=10.0)


def test_without_the_secret_nothing_is_served(server, shown):
    port = server.get_port()
    secret = server.gate.secret
    for path in ("/", "/index.html", "/control", f"/{secret[:-1]}/", f"/{secret}x/", f"/?key={secret}"):
        assert asked(server, path)[0] == 403
    for path in ("", "control"):
        with pytest.raises(InvalidStatus, match="403"):
            connect(f"ws://127.0.0.1:{port}/{path}", origin=f"http://127.0.0.1:{port}", subprotocols=[VISER])
    assert server.gate.rejections.counts == {"without the secret": 8}
    assert len(secret) >= 20
    assert asked(server, f"/{secret}/")[0] == 200


def test_a_name_that_was_made_to_lead_here_is_refused_though_it_has_the_secret(server, shown):
    port, path = server.get_port(), f"/{server.gate.secret}/"
    for host in ("evil.example", f"evil.example:{port}", f"127.0.0.1.evil.example:{port}", f"127.0.0.1:{port + 1}"):
        assert asked(server, path, Host=host)[0] == 403
    for host in (f"localhost:{port}", f"127.0.0.1:{port}", f"[::1]:{port}"):
        assert asked(server, path, Host=host)[0] == 200
    assert server.gate.rejections.counts == {"to another host": 4}


def test_the_page_is_in_nobodys_frame_and_loads_nothing_from_elsewhere(server, shown):
    for path in (f"/{server.gate.secret}/", "/"):
        _, headers = asked(server, path)
        assert headers["X-Frame-Options"] == "DENY"
        policy = headers["Content-Security-Policy"]
        assert "frame-ancestors 'none'" in policy
        assert "default-src 'self'" in policy
        assert headers["Referrer-Policy"] == "no-referrer"


@pytest.fixture
def elsewhere():
    """The address of another page on this machine."""

    class Evil(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()

        def log_message(self, *args):
            pass

    other = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Evil)
    threading.Thread(target=other.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{other.server_port}/"
    other.shutdown()
    other.server_close()


def test_another_page_in_the_same_browser_cannot_stop_drive_or_frame_this_one(
    browser, elsewhere, server, pretender, tmp_path
):
    Teleop(server, pretender, tmp_path)
    page = browser.new_page()
    page.goto(server.gate.address)  # it has been here: the browser may know things that count
    until(lambda: page.evaluate(f"!!{STOP}"), page)
    page.goto(elsewhere)
    tried = page.evaluate(
        """async ([address, root, protocol]) => {
        const said = [];
        for (const url of [address, address + 'control', root, root + 'control'])
            await new Promise(done => {
                const socket = new WebSocket(url.replace('http:', 'ws:'), url.endsWith('control') ? [] : [protocol]);
                socket.onopen = () => { socket.send('{"stop": true}'); said.push('open'); done(); };
                socket.onerror = () => { said.push('refused'); done(); };
            });
        return said;
    }""",
        [server.gate.address, server.gate.address.replace(server.gate.secret + "/", ""), VISER],
    )
    assert tried == ["refused"] * 4
    assert server.gate.rejections.counts["from another page"] == 4
    page.set_content(f'<iframe src="{server.gate.address}"></iframe>')
    page.wait_for_timeout(1000)
    assert not [frame for frame in page.frames[1:] if frame.url.startswith("http")]
    assert not pretender.stopped
    page.close()


def test_nobody_can_have_the_page_published(server, shown, monkeypatch):
    """The message is what viser's client sends; a tunnel would be asked for in a thread."""
    wanted = []
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *args: wanted.append(args))
    with websocket(server, subprotocols=[VISER]) as own:
        for _ in range(3):
            own.send(msgpack.encode({"type": "ShareUrlRequest"}))
        own.send(msgpack.encode({"type": "ShareUrlDisconnect"}))
        wait(lambda: server.gate.rejections.total == 4)
    time.sleep(0.2)
    assert wanted == []
    assert server.gate.rejections.counts == {"of a kind that the page does not use": 4}


def wait(condition, limit=60.0):
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def unusable(rng, teleop):
    """A message of viser's client with something wrong in it."""
    numbers = [math.nan, math.inf, -math.inf, 1e300, 2**63, "1", None, True, [], {}]
    wrong = numbers[rng.integers(len(numbers))]
    slider, button, choice = (h._impl.uuid for h in (teleop._pace, teleop.run_button, teleop._method))
    camera = {"type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [0.0, 0.0, 1.0], "fov": 1.0,
              "near": 0.1, "far": 100.0, "image_height": 10, "image_width": 10, "look_at": [0.0, 0.0, 0.0],
              "up_direction": [0.0, 0.0, 1.0]}  # fmt: skip
    gizmo = {"type": "TransformControlsUpdateMessage", "name": "/target", "owner": "", "wxyz": [1.0, 0.0, 0.0, 0.0]}
    field = list(camera)[rng.integers(1, len(camera))]
    kind = rng.integers(10)
    if kind == 0:
        return rng.bytes(int(rng.integers(0, 200)))
    if kind == 1:
        return msgpack.encode(camera | {field: wrong if rng.random() < 0.5 else [wrong] * int(rng.integers(6))})
    if kind == 2:
        return msgpack.encode(gizmo | {"position": [0.0, wrong, 0.0]})
    if kind == 3:
        return msgpack.encode(gizmo | {"position": [0.0, 0.0, 0.0], "wxyz": [0.0] * 4})
    if kind == 4:
        return msgpack.encode({"type": "GuiUpdateMessage", "uuid": slider, "updates": {"value": wrong}})
    if kind == 5:
        other = [{"value": 9.9}, {"visible": False}, {}, wrong, {"value": 0.3, "max": 9.9}][rng.integers(5)]
        return msgpack.encode({"type": "GuiUpdateMessage", "uuid": slider, "updates": other})
    if kind == 6:  # it is disabled; unknown; not a choice
        updates = [(button, True), ("nobody", True), (choice, "rm -rf")][rng.integers(3)]
        return msgpack.encode({"type": "GuiUpdateMessage", "uuid": updates[0], "updates": {"value": updates[1]}})
    if kind == 7:
        types = [
            "SceneNodeDragMessage",
            "FileTransferStartUpload",
            "RunJavascriptMessage",
            "Message",
            3,
            None,
            [],
            "no",
        ]
        return msgpack.encode({"type": types[rng.integers(len(types))], "name": "/target", "uuid": slider})
    if kind == 8:
        return msgpack.encode([wrong, {"type": 1}])
    valid = msgpack.encode({"type": "GuiUpdateMessage", "uuid": slider, "updates": {"value": 0.8}})
    return valid[: rng.integers(len(valid))] if rng.random() < 0.8 else "text"


def test_10_000_unusable_messages_are_refused_and_counted_and_the_page_works_meanwhile(
    server, pretender, running, tmp_path, rng
):
    teleop = Teleop(server, pretender, tmp_path)
    running(teleop.loop)
    with websocket(server, subprotocols=[VISER]) as fuzzer, websocket(server, "control") as control:
        threaded = Counter()
        for i in range(10_000):
            fuzzer.send(unusable(rng, teleop))
            if i % 500 == 0:
                control.send('{"held": ""}')
                threaded["answers"] += "age" in json.loads(control.recv(timeout=30.0))
                while fuzzer.protocol.state.name == "OPEN" and i % 1000 == 0:
                    try:
                        fuzzer.recv(timeout=0.01)
                    except TimeoutError:
                        break
        wait(lambda: server.gate.rejections.total == 10_000)
        assert threaded["answers"] == 20
        assert pretender.orders == []
        assert not pretender.stopped
        assert teleop._pace.value == 0.3
        assert np.allclose(teleop.gizmo.position, pretender.robot.forward(pretender.state.q)[:3, 3], atol=1e-6)
        fuzzer.send(msgpack.encode(
            {"type": "GuiUpdateMessage", "uuid": teleop._pace._impl.uuid, "updates": {"value": 0.5}}
        ))  # fmt: skip
        wait(lambda: teleop._pace.value == 0.5)  # what is usable comes through
        control.send('{"stop": true}')
        wait(lambda: pretender.stopped)
    assert server.gate.rejections.counts["malformed"] > 1000


def test_a_huge_message_ends_its_own_connection_alone(server, pretender, tmp_path):
    Teleop(server, pretender, tmp_path)
    with websocket(server, subprotocols=[VISER]) as huge, websocket(server, "control") as control:
        huge.send(b"\x00" * (1 << 20))
        wait(lambda: server.gate.rejections.counts["too large"] == 1)
        control.send('{"held": ""}')
        assert "age" in json.loads(control.recv(timeout=10.0))


def test_words_of_the_control_channel_that_are_unusable_hold_nothing_and_stop_nothing(server, pretender, tmp_path):
    teleop = Teleop(server, pretender, tmp_path)
    held = ['{"held": "X"}', '{"held": "II"}', '{"held": 3}', '{"held": ["I"]}', '{"held": "' + "I" * 200 + '"}']
    stop = ['{"stop": false}', '{"stop": 1e999}', '{"held": "I", "stop": true}']
    words = [*held, *stop, "[]", "null", "{}", "nonsense"]
    with websocket(server, "control") as control:
        for word in words:
            control.send(word)
        control.send(b'{"stop": true}')
        wait(lambda: server.gate.rejections.counts["malformed"] == len(words) + 1)
        assert teleop.control.twist() is None
        assert not pretender.stopped
        control.send('{"held": "IU"}')
        assert "age" in json.loads(control.recv(timeout=10.0))
    assert parse('{"held": "IU"}') == ("IU", False)


MARKUP = [
    "<style>#longreach-stop{display:none}</style>",
    "![x](http://evil.example/x.png) **bold** [a](javascript:alert(1))",
    "<img src=http://evil.example/y.png onerror=\"document.getElementById('longreach-stop').remove()\">",
    "</div><script>document.title='owned'</script>{document.title='owned'}",
]


def test_a_reason_or_a_name_from_the_network_is_text_on_the_page(page, server, pretender, running, tmp_path):
    fetched = []
    page.on("request", lambda request: fetched.append(request.url))
    pretender.stop()
    teleop = Teleop(server, pretender, tmp_path)
    running(teleop.loop)
    page.goto(server.gate.address)
    until(lambda: page.evaluate(f"!!{STOP}"), page)
    until(lambda: server.get_clients(), page)
    for words in MARKUP:
        pretender.reason = pretender.holder = words
        teleop._tell(words, words)  # an error that names it
        shown = "document.body.innerText.split(words).length - 1".replace("words", json.dumps(words))
        until(lambda shown=shown: page.evaluate(shown) >= 4, page)  # reason, holder, and a notification's two
        assert page.evaluate(f"{STOP}.checkVisibility() && getComputedStyle({STOP}).display != 'none'")
        assert page.title() != "owned"
        assert not [url for url in fetched if "evil" in url]
        assert page.errors == []
