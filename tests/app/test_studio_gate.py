"""The gate of the studio fails closed: foreign hosts, origins and pages, missing secrets, traversal, floods."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.routing import Route
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from rotorfit.app.loopback.gate import POLICY, cookie_name
from rotorfit.app.web import routes, workspace
from rotorfit.app.web.routes import Studio
from rotorfit.app.web.workspace import safe_name
from studio_room import COOKIE, HOST, ORIGIN, PAGE, PORT, TOKEN, added, bag, client_of, session_of


def every_request(studio: Studio) -> list[tuple[str, str]]:
    """Method and address of all that the studio answers."""
    known = [route for route in studio._routes() if isinstance(route, Route)]
    fill = {"{name}": "main.js", "{log}": "1", "{fit}": "1", "{file}": "model.json", "{format}": "numpy"}
    out = []
    for route in known:
        path = route.path
        for what, value in fill.items():
            path = path.replace(what, value)
        out += [(method, path) for method in sorted(route.methods or ())]
    return out


def test_without_the_secret_nothing_answers_whatever_is_asked(studio: Studio) -> None:
    asked = every_request(studio)

    for headers in ({}, {"cookie": f"{cookie_name(PORT)}=wrong"}, {"authorization": "Bearer wrong"}):
        answers = [client_of(studio, {**headers, "origin": ORIGIN}).request(*one) for one in asked]
        assert {answer.status_code for answer in answers} == {401}
    assert len(asked) > 20
    assert studio.workspace.session.revision == 1


@pytest.mark.parametrize(
    "headers",
    [
        {"authorization": TOKEN},
        {"authorization": f"Basic {TOKEN}"},
        {"authorization": f"Bearer {TOKEN}x"},
        {"authorization": f"Bearer {TOKEN[:-1]}"},
        {"authorization": "Bearer "},
        {"cookie": f"{cookie_name(PORT + 1)}={TOKEN}"},
        {"cookie": f"{cookie_name(PORT)}="},
        {"cookie": "\x7f=;;;==" + TOKEN},
        {"x-token": TOKEN},
    ],
)
def test_what_is_only_nearly_the_secret_is_refused(studio: Studio, headers: dict[str, str]) -> None:
    assert client_of(studio, headers).get("/api/session").status_code == 401


def test_the_secret_in_an_address_opens_the_page_and_nothing_else(studio: Studio) -> None:
    stranger = client_of(studio, {})

    assert stranger.get(f"/api/session?token={TOKEN}").status_code == 401
    assert stranger.get(f"/page/main.js?token={TOKEN}").status_code == 401
    assert stranger.get(f"/?token=x&token={TOKEN}").status_code == 401
    answer = stranger.get(f"/?token={TOKEN}")
    assert answer.status_code == 200
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert str(PORT) in cookie.partition("=")[0]
    assert TOKEN not in answer.text


@pytest.mark.parametrize(
    "host",
    [
        "evil.example", f"evil.example:{PORT}", f"127.0.0.1:{PORT + 1}", "127.0.0.1", f"127.0.0.1.evil.example:{PORT}",
        f"localhost.evil.example:{PORT}", f"0.0.0.0:{PORT}", f"[::1]:{PORT}", f"127.0.0.1:{PORT}@evil.example", "",
    ],
)  # fmt: skip
def test_a_host_that_is_not_this_one_is_refused_as_after_dns_rebinding(studio: Studio, host: str) -> None:
    client = client_of(studio)

    for method, path in (("GET", "/api/session"), ("GET", f"/?token={TOKEN}"), ("DELETE", "/api/logs/1")):
        assert client.request(method, path, headers={"host": host}).status_code == 403


@pytest.mark.parametrize("host", [HOST, f"localhost:{PORT}", f"LOCALHOST:{PORT}"])
def test_the_own_host_is_let_in_by_both_of_its_names(studio: Studio, host: str) -> None:
    assert client_of(studio, COOKIE).get("/api/session", headers={"host": host}).status_code == 200


FOREIGN = (
    {"origin": "https://evil.example"},
    {"origin": "null"},
    {"origin": f"http://127.0.0.1:{PORT + 1}"},
    {"origin": f"https://{HOST}"},
    {"origin": f"{ORIGIN}.evil.example"},
    {"origin": ORIGIN, "sec-fetch-site": "cross-site"},
    {"sec-fetch-site": "cross-site"},
    {"sec-fetch-site": "same-site"},
    {"sec-fetch-site": "none"},
    {},
)


@pytest.mark.parametrize("headers", FOREIGN)
def test_another_page_changes_nothing_although_the_browser_adds_the_cookie(
    studio: Studio, page: TestClient, headers: dict[str, str]
) -> None:
    added(page)
    before = session_of(page)
    attacker = client_of(studio, {**COOKIE, **headers})

    for method, path in every_request(studio):
        if method not in ("GET", "HEAD"):
            assert attacker.request(method, path, content=b"{}").status_code == 403, (method, path)
    assert session_of(page) == before


@pytest.mark.parametrize("headers", [one for one in FOREIGN if one not in ({}, {"sec-fetch-site": "none"})])
def test_another_page_reads_nothing(studio: Studio, headers: dict[str, str]) -> None:
    attacker = client_of(studio, {**COOKIE, **headers})

    assert {attacker.get(path).status_code for method, path in every_request(studio) if method == "GET"} == {403}


def test_no_answer_ever_allows_another_origin(studio: Studio, page: TestClient) -> None:
    answers = [page.get("/"), page.get("/api/session"), page.options("/api/session"), client_of(studio, {}).get("/")]

    assert [answer.headers.get("access-control-allow-origin") for answer in answers] == [None] * 4


def test_a_program_with_the_secret_needs_no_page(studio: Studio) -> None:
    program = client_of(studio, {"authorization": f"Bearer {TOKEN}"})

    assert program.put("/api/card", json={"builtin": "bebop2", "seen": 0}).status_code == 200


def test_every_answer_keeps_the_browser_careful_refusals_too(studio: Studio, page: TestClient) -> None:
    for answer in (page.get("/"), page.get("/api/session"), page.get("/nowhere"), client_of(studio, {}).get("/")):
        assert answer.headers["content-security-policy"] == POLICY
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cache-control"] == "no-store"
    assert "unsafe" not in POLICY


def test_the_page_holds_no_script_style_or_handler_of_its_own_and_never_makes_markup_of_text() -> None:
    folder = Path(routes.__file__).parent / "page"
    markup = (folder / "index.html").read_text()
    scripts = {path.name: path.read_text() for path in folder.glob("*.js")}

    assert "<style" not in markup
    assert " on" not in markup.replace(" on the", "")
    assert (
        markup.count("<script")
        == markup.count("</script>")
        == markup.count("<script src=") + markup.count('<script type="module" src=')
    )
    assert "http" not in markup
    for name, text in scripts.items():
        for way in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "Function("):
            assert way not in text, (name, way)


# Paths


@pytest.mark.parametrize(
    "path",
    [
        "/page/../routes.py", "/page/..%2froutes.py", "/page/%2e%2e/routes.py", "/page/%2fetc%2fpasswd",
        "/page/index.html", "/page/..%5croutes.py", "/page/", "/page/main.js%00.css", "/api/logs/..",
        "/api/logs/..%2f..%2fsession.json", "/api/logs/1%2f..%2f..", "/api/fits/1/..%2f..%2f..%2fsession.json",
        "/api/fits/..%2flogs/model.json", "/api/fits/1/request.json", "/api/fits/1/trace.txt",
        "/api/fits/1/card.toml", "/session.json", "//etc/passwd",
    ],
)  # fmt: skip
def test_no_path_leads_out_of_what_is_served(page: TestClient, path: str) -> None:
    answer = page.get(path)

    assert answer.status_code in (404, 405, 422)
    assert "root:" not in answer.text
    assert "import" not in answer.text


@pytest.mark.parametrize(
    "name",
    [
        "../../evil.bag", "/etc/passwd", "..", ".", "", "a\x00b.bag", "C:\\x.bag", "a+b.bag", "a@0:1", "-rf",
        "x" * 4000, "лог.bag", "<b>&\"'",
    ],
)  # fmt: skip
def test_a_name_of_an_upload_stays_text_and_its_file_stays_in_its_folder(
    studio: Studio, page: TestClient, name: str
) -> None:
    upload = studio.workspace.upload(added(page, name))
    path = studio.workspace.path_of(upload).resolve()

    assert path.parent == studio.workspace.folder / "logs" / upload.id
    assert path.is_file()
    assert upload.name == (name[-200:] or "log")
    assert upload.file == safe_name(upload.name)
    assert not set(upload.file) & set("/\\+@ \x00")
    assert upload.file[0] not in ".-"
    assert page.get(f"/api/logs/{upload.id}").status_code == 200


# Floods


def files_in(studio: Studio) -> list[Path]:
    return [path for path in (studio.workspace.folder / "logs").rglob("*") if path.is_file()]


def test_an_upload_that_says_it_is_too_large_is_refused_before_it_is_read(
    studio: Studio, page: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(routes, "LARGEST_LOG", 1000)

    answer = page.post("/api/logs?name=big.bag", content=bag(1))

    assert answer.status_code == 413
    assert "larger than" in answer.json()["error"]
    assert files_in(studio) == []


def test_an_upload_that_lies_about_its_size_is_cut_off_and_removed(
    studio: Studio, page: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(routes, "LARGEST_LOG", 100_000)
    read = []

    def endless() -> Iterator[bytes]:
        for number in range(1000):
            read.append(number)
            yield b"x" * 10_000

    answer = page.post("/api/logs?name=big.bag", content=endless())

    assert answer.status_code == 413
    assert files_in(studio) == []
    assert session_of(page)["uploads"] == []


def test_all_logs_together_have_a_limit_and_their_number_too(
    page: TestClient, studio: Studio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workspace, "LARGEST_WORKSPACE", len(bag(1)) + 10)
    added(page)
    assert page.post("/api/logs?name=b.bag", content=bag(1)).status_code == 413

    monkeypatch.setattr(workspace, "MOST_LOGS", 1)
    assert "at most 1" in page.post("/api/logs?name=c.bag", content=b"x").json()["error"]
    assert len(files_in(studio)) == 1


@pytest.mark.parametrize("body", [b"{" * 200_000, b"[" * 100_000 + b"]" * 100_000, b"\xff\xfe", b"NaN", b"[]", b"3"])
def test_a_request_that_is_no_request_is_one_line(page: TestClient, body: bytes) -> None:
    answer = page.put("/api/card", content=body)

    assert answer.status_code in (400, 422)
    assert "\n" not in answer.json()["error"]


def test_a_request_that_is_too_large_is_refused(page: TestClient) -> None:
    answer = page.put("/api/card", content=json.dumps({"text": "x" * (1 << 20), "seen": 0}).encode())

    assert answer.status_code == 413


def test_websockets_are_not_spoken(studio: Studio) -> None:
    with pytest.raises(WebSocketDisconnect), client_of(studio).websocket_connect("/", headers=PAGE):
        pass
