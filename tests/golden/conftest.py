import pytest


def pytest_addoption(parser):
    parser.addoption(
        "--update-golden",
        action="store_true",
        help="write the golden files of tests/golden anew instead of comparing with them",
    )


@pytest.fixture
def update_golden(request) -> bool:
    # The option only exists if pytest's command line names this folder.
    return bool(request.config.getoption("--update-golden", default=False))
