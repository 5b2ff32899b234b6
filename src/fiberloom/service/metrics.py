"""Figures for Prometheus: what the array does, how good it is, how the service is."""

from __future__ import annotations

import time
from collections import Counter as Tally
from collections.abc import Iterator
from typing import Any

import numpy as np
from prometheus_client import CollectorRegistry, Counter, Gauge, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector

from fiberloom.service.array import ServedArray
from fiberloom.service.live import STATES
from fiberloom.store.service.alarms import Severity

QUANTILES = (0.5, 0.95, 1.0)


class Metrics:
    """The figures of one service."""

    def __init__(self, array: ServedArray) -> None:
        self._registry = CollectorRegistry()
        self._registry.register(_ArrayFigures(array))
        self.commands = Counter(
            "fiberloom_commands", "Commands that have ended.", ("command", "result"), registry=self._registry
        )
        self.command_s = Counter(
            "fiberloom_command_seconds", "Time spent in commands.", ("command",), registry=self._registry
        )
        self.lag_s = Gauge(
            "fiberloom_loop_lag_seconds", "By which the server's loop was late.", registry=self._registry
        )
        self._begun: dict[str, float] = {}

    def event(self, kind: str, content: dict[str, Any]) -> None:
        """Counts commands by an event of the hub: its `kind` and `content`."""
        if kind != "command" or "result" not in content:
            return
        name, result = content["command"], content["result"]
        if result == "running":
            self._begun[name] = time.monotonic()
            return
        self.commands.labels(name, result).inc()
        if (begun_s := self._begun.pop(name, None)) is not None:
            self.command_s.labels(name).inc(time.monotonic() - begun_s)

    def text(self) -> bytes:
        """As Prometheus reads it."""
        return generate_latest(self._registry)


class _ArrayFigures(Collector):
    """Read from the picture and the alarms when they are asked for."""

    def __init__(self, array: ServedArray) -> None:
        self._array = array

    def collect(self) -> Iterator[GaugeMetricFamily]:
        live, hub = self._array.live, self._array.hub
        yield GaugeMetricFamily("fiberloom_moves", "Moves since the service began.", value=live.moves)
        yield GaugeMetricFamily("fiberloom_clients", "Clients of the stream.", value=len(hub))
        running = float(self._array.running is not None)
        yield GaugeMetricFamily("fiberloom_command_running", "1: a command runs.", value=running)
        if live.image_utc:
            age_s = time.time() - live.image_utc
            yield GaugeMetricFamily("fiberloom_image_age_seconds", "Since the last image.", value=age_s)
        yield self._errors()
        yield self._positioners()
        yield self._alarms()

    def _errors(self) -> GaugeMetricFamily:
        found = GaugeMetricFamily(
            "fiberloom_error_um", "Distance from targets in the last image.", labels=["quantile"]
        )
        if len(errors_um := self._array.live.errors_um()):
            for q in QUANTILES:
                found.add_metric([str(q)], float(np.quantile(errors_um, q)))
        return found

    def _positioners(self) -> GaugeMetricFamily:
        found = GaugeMetricFamily("fiberloom_positioners", "Positioners by state.", labels=["state"])
        tally = Tally(self._array.live.states())
        for code, name in enumerate(STATES):
            found.add_metric([name], tally[code])
        return found

    def _alarms(self) -> GaugeMetricFamily:
        found = GaugeMetricFamily("fiberloom_alarms", "Alarms that are not over.", labels=["severity"])
        tally = Tally(alarm.severity for alarm in self._array.alarms.open())
        for severity in Severity:
            found.add_metric([severity.value], tally[severity.value])
        return found
