import pytest
from matplotlib.figure import Figure


@pytest.fixture
def written(monkeypatch):
    """Every figure that is written to a file, in order, to look at what was drawn."""
    kept = []
    original = Figure.savefig

    def savefig(figure, *arguments, **how):
        kept.append(figure)
        return original(figure, *arguments, **how)

    monkeypatch.setattr(Figure, "savefig", savefig)
    return kept
