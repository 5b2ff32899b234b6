"""Whatever the OpenAPI document allows, and what it does not: no answer is a 500."""

import os

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from served import OURS, asking, idle, served

schemathesis = pytest.importorskip(
    "schemathesis", reason="pip install schemathesis: requests by the OpenAPI document"
)
from schemathesis import GenerationMode  # noqa: E402

EXAMPLES = int(os.environ.get("FIBERLOOM_FUZZED", "4"))
"""Of each operation."""
EXPECTED = (200, 202, 400, 403, 404, 405, 409, 413, 421, 422, 503)


@pytest.fixture(scope="module")
def array(tmp_path_factory):
    with served(tmp_path_factory.mktemp("fuzzed")) as array:
        yield array


@pytest.fixture(scope="module")
def client(array):
    with asking(array, array.place.base) as client:
        yield client
        idle(array)


def operations(client):
    """Of the document, by method and path."""
    schema = schemathesis.openapi.from_dict(client.get("/openapi.json").json())
    return [found.ok() for found in schema.get_all_operations()]


def asked(client, case):
    """The answer to a generated case, as from the page."""
    how = case.as_transport_kwargs(base_url=str(client.base_url))
    headers = {k: v for k, v in dict(how.get("headers") or {}).items() if v.isascii()} | OURS
    chosen = {name: how[name] for name in ("method", "url", "params", "json", "data") if name in how}
    if isinstance(chosen.get("data"), bytes):
        chosen["content"] = chosen.pop("data")
    return client.request(headers=headers, **chosen)


@pytest.mark.slow
def test_no_request_is_answered_by_a_500(client):
    tried = set()

    def all_of(operation):
        @settings(
            max_examples=EXAMPLES,
            deadline=None,
            derandomize=True,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(
            st.one_of(operation.as_strategy(), operation.as_strategy(generation_mode=GenerationMode.NEGATIVE))
        )
        def tries(case):
            answer = asked(client, case)
            tried.add((operation.method, operation.path, answer.status_code))
            assert answer.status_code in EXPECTED, (case, answer.text)

        tries()

    for operation in operations(client):
        all_of(operation)
    assert {status for *_, status in tried} >= {200, 202, 400, 409, 422}
    assert len({path for _, path, _ in tried}) >= 18


def test_the_document_names_all_commands(client):
    paths = client.get("/openapi.json").json()["paths"]
    assert {"/api/stop", "/api/v1/observe", "/api/v1/park", "/api/v1/home", "/api/v1/recover"} <= set(paths)
    assert all("409" in paths[p]["post"]["responses"] for p in ("/api/v1/observe", "/api/v1/park"))
