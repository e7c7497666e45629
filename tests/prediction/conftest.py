"""Methods of prediction with other settings."""

import functools
from dataclasses import replace

import pytest

from mcspectra.prediction import prediction


@pytest.fixture
def use_settings(monkeypatch):
    """Apply settings to methods by name, for all predictions of a test."""

    def use(**settings):
        methods = tuple(
            replace(each, predict=functools.partial(each.predict, settings=settings[each.name]))
            if each.name in settings
            else each
            for each in prediction.METHODS
        )
        monkeypatch.setattr(prediction, "METHODS", methods)

    return use
