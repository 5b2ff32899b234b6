"""Who is let in: hosts, origins, headers, tokens, cookies, roles, sizes; and what is not refused."""

import pytest
from served import HOST, OURS, PORT, STREAM, asking, gate, served
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from fiberloom.cli.array.serve import ServeOptions, listening
from fiberloom.errors import InputError
from fiberloom.service.guard.tokens import FAILURES, WITHIN_S, Failures, Logins, Role, TokenFile
from fiberloom.service.guard.wall import BODY_BYTES, UPLOAD_BYTES, hosts_of, is_loopback
from fiberloom.service.web.app import application
from fiberloom.service.web.target_root import TargetRoot

VIEW, OPERATE, ENGINEER = (letter * 32 for letter in "voe")


def bearer(token):
    return {"Authorization": f"Bearer {token}"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("guarded")


@pytest.fixture(scope="module")
def array(folder):
    with served(folder) as array:
        yield array


@pytest.fixture(scope="module")
def tokens(folder):
    path = folder / "tokens"
    path.write_text(f"# of the night\nviewer vic {VIEW}\noperator oli {OPERATE}\nengineer eve {ENGINEER}\n")
    path.chmod(0o600)
    return TokenFile.read(path)


@pytest.fixture
def client(array, folder, tokens):
    """With tokens, and headers of the page."""
    with asking(array, folder, tokens) as client:
        yield client


@pytest.fixture
def local(array, folder):
    """Without tokens, as on loopback."""
    with asking(array, folder, headers={}) as client:
        yield client


def test_without_tokens_the_user_of_this_machine_is_engineer(local):
    assert local.get("/api/v1/whoami").json() == {"name": "local", "role": "engineer", "tokens": False}
    assert local.post("/api/stop", headers=OURS).status_code == 200


@pytest.mark.parametrize("missing", list(OURS))
def test_what_changes_something_needs_the_header_and_our_origin(local, missing):
    headers = {name: value for name, value in OURS.items() if name != missing}
    for method, path in (("POST", "/api/v1/park"), ("POST", "/api/stop"), ("PUT", "/api/v1/targets/a.csv")):
        assert local.request(method, path, headers=headers).status_code == 403, path


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", f"https://{HOST}:{PORT}", f"http://{HOST}:{PORT + 1}", "null", f"http://{HOST}"],
)
def test_a_foreign_origin_is_refused(local, origin):
    headers = OURS | {"Origin": origin}
    assert local.post("/api/v1/park", headers=headers).status_code == 403
    with pytest.raises(WebSocketDisconnect), local.websocket_connect(STREAM, headers={"Origin": origin}):
        pass


def test_a_stream_without_an_origin_is_refused(local):
    with pytest.raises(WebSocketDisconnect), local.websocket_connect(STREAM):
        pass


@pytest.mark.parametrize("host", ["evil.example", f"evil.example:{PORT}", f"{HOST}:1", ""])
def test_a_foreign_host_is_refused(local, host):
    """A page of another name that points to this address (DNS rebinding) reads nothing."""
    for path in ("/", "/api/v1/state", "/openapi.json", "/healthz"):
        assert local.get(path, headers={"Host": host}).status_code == 421, path


def test_no_other_page_is_given_leave_by_cors(local):
    asked = {"Origin": "http://evil.example", "Access-Control-Request-Method": "POST"}
    answer = local.options("/api/v1/park", headers=asked)
    assert "access-control-allow-origin" not in answer.headers
    assert "access-control-allow-origin" not in local.get("/api/v1/state", headers=asked).headers


def test_every_answer_says_what_a_page_may_load(local):
    for path in ("/", "/page/main.js", "/api/v1/state", "/page/none.js", "/api/v1/none"):
        headers = local.get(path).headers
        assert headers["content-security-policy"].startswith("default-src 'self';")
        assert headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(
    "path",
    ["/page/../app.py", "/page/..%2f..%2farray.py", "/page/%2e%2e/array.py", "/page//etc/passwd", "/page/"],
)
def test_the_page_is_its_files_and_no_path_leads_elsewhere(local, path):
    assert local.get(path).status_code == 404


def test_nothing_is_told_without_a_token(client):
    for path in ("/api/v1/state", "/api/v1/plane", "/api/v1/commands", "/metrics", "/api/v1/targets"):
        assert client.get(path).status_code == 401, path
    assert client.post("/api/stop").status_code == 401
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(STREAM):
        pass
    assert client.get("/").status_code == client.get("/healthz").status_code == 200


ROUTES = {
    "viewer": [("GET", "/api/v1/state"), ("GET", "/metrics"), ("GET", "/api/v1/commands")],
    "operator": [("POST", "/api/stop"), ("POST", "/api/v1/alarms/99/acknowledge")],
    "engineer": [("POST", "/api/v1/exclude"), ("POST", "/api/v1/home"), ("POST", "/api/v1/recover")],
}


@pytest.mark.parametrize(
    ("token", "role"), [(VIEW, Role.VIEWER), (OPERATE, Role.OPERATOR), (ENGINEER, Role.ENGINEER)]
)
def test_a_role_may_what_it_may_and_no_more(client, token, role):
    for needed, routes in ROUTES.items():
        for method, path in routes:
            status = client.request(method, path, headers=bearer(token), json={"x": 1}).status_code
            assert (status == 403) == (Role[needed.upper()] > role), (path, status)


@pytest.mark.parametrize("path", ["/api/v1/observe", "/api/v1/park", "/api/v1/targets/a.csv"])
def test_a_viewer_moves_nothing(client, path):
    method = "PUT" if "targets/" in path else "POST"
    answer = client.request(method, path, headers=bearer(VIEW), json={"targets": "t.csv"})
    assert (answer.status_code, "operator" in answer.text) == (403, True)


def test_a_token_becomes_a_cookie_that_scripts_cannot_read(client, array):
    answer = client.post("/api/v1/login", headers=bearer(OPERATE))
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert OPERATE not in cookie
    assert client.get("/api/v1/whoami").json() == {"name": "oli", "role": "operator", "tokens": True}
    with client.websocket_connect(STREAM) as stream:
        assert stream.receive_bytes()[:4] == b"FLP1"
    assert client.post("/api/stop").json()["text"] == "nothing moves"
    # with the cookie alone a foreign page does nothing
    assert client.post("/api/stop", headers={"Origin": "http://evil.example"}).status_code == 403
    assert array.commands.last()[0].author == "oli"
    assert client.post("/api/v1/logout").json() == {"out": True}
    assert client.get("/api/v1/whoami").json()["role"] == "none"
    assert client.get("/api/v1/state").status_code == 401


def test_a_program_with_a_token_needs_no_origin(array, folder, tokens):
    with asking(array, folder, tokens, headers={"X-Fiberloom": "1"}) as program:
        assert program.post("/api/stop", headers=bearer(OPERATE)).status_code == 200
        foreign = bearer(OPERATE) | {"Origin": "http://evil.example"}
        assert program.post("/api/stop", headers=foreign).status_code == 403


def test_six_wrong_tokens_and_a_stop_that_is_not_made_to_wait(client):
    tries = [client.get("/api/v1/state", headers=bearer("x" * 32)).status_code for _ in range(6)]
    assert tries == [401] * FAILURES + [429]
    waiting = client.get("/api/v1/state", headers=bearer(OPERATE))
    assert waiting.status_code == 429
    assert 0 < int(waiting.headers["retry-after"]) <= WITHIN_S + 1
    assert client.post("/api/stop", headers=bearer(OPERATE)).status_code == 200
    assert client.post("/api/stop", headers=bearer("x" * 32)).status_code == 401


def test_failures_are_forgotten_after_a_minute():
    now = [0.0]
    failures = Failures(lambda: now[0])
    for _ in range(FAILURES):
        assert failures.wait_s("a") == 0.0
        failures.count("a")
        now[0] += 1.0
    assert failures.wait_s("a") == WITHIN_S - FAILURES
    assert failures.wait_s("b") == 0.0
    now[0] = WITHIN_S
    assert failures.wait_s("a") == 0.0


def test_a_login_ends_after_a_night(tokens):
    now = [0.0]
    logins = Logins(lambda: now[0])
    secret = logins.begin(tokens.identity(VIEW))
    assert logins.identity(secret).name == "vic"
    now[0] = 13 * 3600.0
    assert logins.identity(secret) is None


def test_bodies_have_bounds(client):
    headers = bearer(OPERATE) | {"Content-Type": "application/json"}
    assert client.post("/api/v1/observe", headers=headers, content=b" " * (BODY_BYTES + 1)).status_code == 413
    # its length is told: refused before it is read
    told = headers | {"Content-Length": str(100 << 20)}
    assert client.put("/api/v1/targets/a.csv", headers=told, content=b"a").status_code == 413
    for length in ("-1", "1e9", "9" * 40):
        odd = headers | {"Content-Length": length}
        assert client.put("/api/v1/targets/a.csv", headers=odd, content=b"a").status_code == 413, length


def test_a_body_that_does_not_tell_its_length_has_bounds_too(client):
    sent = []

    def pieces():
        while len(sent) << 20 < 100 << 20:
            sent.append(1)
            yield bytes(1 << 20)

    answer = client.put("/api/v1/targets/a.csv", headers=bearer(OPERATE), content=pieces())
    assert answer.status_code == 413


def test_a_header_twice_counts_as_none(array, folder):
    app = application(array, gate(), TargetRoot(folder / "targets"))
    with TestClient(app, base_url=f"http://{HOST}:{PORT}") as client:
        twice = [*OURS.items(), ("Origin", "http://evil.example")]
        assert client.post("/api/v1/park", headers=twice).status_code == 403


@pytest.mark.parametrize(
    ("text", "mode", "word"),
    [
        (f"viewer vic {VIEW}\n", 0o644, "others may read it"),
        ("viewer vic short\n", 0o600, "5 letters"),
        (f"king vic {VIEW}\n", 0o600, "line 1"),
        (f"viewer {VIEW}\n", 0o600, "line 1"),
        ("# nothing\n", 0o600, "no token"),
    ],
)
def test_a_token_file_that_is_not_sound_is_refused(tmp_path, text, mode, word):
    path = tmp_path / "tokens"
    path.write_text(text)
    path.chmod(mode)
    with pytest.raises(InputError, match=word):
        TokenFile.read(path)


def test_beyond_loopback_only_with_tokens_and_tls(folder, tokens, tmp_path):
    with pytest.raises(InputError, match="--token-file"):
        listening(ServeOptions(listen="0.0.0.0:8080"))
    with pytest.raises(InputError, match="--tls-cert"):
        listening(ServeOptions(listen="0.0.0.0:8080", token_file=folder / "tokens"))
    for name in ("cert.pem", "key.pem"):
        (tmp_path / name).write_text("")
    at, gate_of = listening(
        ServeOptions(
            listen="10.1.10.5:8443",
            token_file=folder / "tokens",
            allow_host="fps.example.org",
            tls_cert=tmp_path / "cert.pem",
            tls_key=tmp_path / "key.pem",
        )
    )
    assert (at.url, gate_of.scheme) == ("https://10.1.10.5:8443/", "https")
    assert gate_of.hosts == {"10.1.10.5:8443", "fps.example.org:8443"}


def test_hosts_by_which_the_service_is_asked():
    assert hosts_of("127.0.0.1", 80, ()) >= {"localhost", "localhost:80", "127.0.0.1", "[::1]:80"}
    assert hosts_of("::1", 8080, ()) == {"localhost:8080", "127.0.0.1:8080", "[::1]:8080"}
    assert [is_loopback(h) for h in ("127.9.9.9", "::1", "localhost", "0.0.0.0", "10.0.0.1", "::")] == [
        *[True] * 3, *[False] * 3,
    ]  # fmt: skip


def test_uploads_are_larger_than_commands():
    assert BODY_BYTES < 100_000 < UPLOAD_BYTES < 100 << 20
