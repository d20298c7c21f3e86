# pyright: strict
"""A DC supply with n channels over SCPI: `VOLT v,(@n)`, `CURR a,(@n)`, `OUTP ON|OFF,(@n)`, `MEAS:…?`.

A channel whose load draws more than its limit goes into constant current: its voltage falls to where a
load of the same resistance draws the limit, and stays there (`STAT:QUES:COND? (@n)` bit 0) until the
channel is switched or set anew. Setting and read-back are 16 bit.

Omitted: rise time and overshoot, output impedance, remote sensing, loads that are not resistive in
constant current, thermal derating and over-voltage protection.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from dut_emulator.instruments.accuracy import Accuracy, Reading
from dut_emulator.instruments.scpi import (
    Call,
    ScpiError,
    ScpiInstrument,
    boolean,
    expression_items,
    formatted,
    number,
)
from dut_emulator.instruments.wiring import Load

MAX_VOLTAGE_V = 20.0
MAX_CURRENT_A = 2.0
VOLTAGE_ACCURACY = Accuracy(
    gain_uncertainty=1e-4, zero_uncertainty=3e-4, noise_deviation=2e-4, resolution=MAX_VOLTAGE_V / 2**16
)
CURRENT_ACCURACY = Accuracy(
    gain_uncertainty=2e-4, zero_uncertainty=5e-5, noise_deviation=4e-5, resolution=MAX_CURRENT_A / 2**16
)
SETTING_GAIN_UNCERTAINTY = 1e-4
SETTING_STEP_V = MAX_VOLTAGE_V / 2**16
CONSTANT_CURRENT_BIT = 1


@dataclass
class _Channel:
    load: Load
    setting: Reading
    voltage: Reading
    current: Reading
    set_voltage_v: float = 0.0
    limit_a: float = 0.1
    on: bool = False
    constant_current: bool = False
    output_v: float = 0.0


class PowerSupply(ScpiInstrument):
    """A supply whose channel n feeds `loads[n − 1]`."""

    def __init__(self, loads: Sequence[Load], seed: int, serial: str) -> None:
        super().__init__(f"Testloom,PS{len(loads)},{serial},1.0")
        self._channels = [
            _Channel(
                load,
                Reading(Accuracy(SETTING_GAIN_UNCERTAINTY, 1e-4, 0.0, SETTING_STEP_V), seed, f"set {index}"),
                Reading(VOLTAGE_ACCURACY, seed, f"volt {index}"),
                Reading(CURRENT_ACCURACY, seed, f"curr {index}"),
            )
            for index, load in enumerate(loads, start=1)
        ]
        self.commands.add("[SOURce:]VOLTage", self._set_voltage)
        self.commands.add("[SOURce:]CURRent", self._set_limit)
        self.commands.add("OUTPut[:STATe]", self._switch)
        self.commands.add("[SOURce:]VOLTage?", self._voltage_setting)
        self.commands.add("[SOURce:]CURRent?", self._limit_setting)
        self.commands.add("OUTPut[:STATe]?", self._state)
        self.commands.add("MEASure[:SCALar]:VOLTage[:DC]?", self._measure_voltage)
        self.commands.add("MEASure[:SCALar]:CURRent[:DC]?", self._measure_current)
        self.commands.add("STATus:QUEStionable:CONDition?", self._condition)

    def reset(self, now_s: float) -> None:
        """All channels off, 0 V."""
        for channel in self._channels:
            channel.on, channel.set_voltage_v, channel.limit_a = False, 0.0, 0.1
            self._drive(channel, now_s)

    def is_on(self, channel: int) -> bool:
        """Whether a channel (from 1) is switched on."""
        return self._channels[channel - 1].on

    def _drive(self, channel: _Channel, now_s: float) -> None:
        """Put the set voltage on the load, free of any former limiting."""
        channel.constant_current = False
        true = channel.set_voltage_v if channel.on else 0.0
        channel.output_v = max(channel.setting.of(true, now_s), 0.0) if channel.on else 0.0
        channel.load.set_supply(channel.output_v, now_s)
        self._limit(channel, now_s)

    def _limit(self, channel: _Channel, now_s: float) -> None:
        if not channel.on or channel.constant_current:
            return
        drawn_a = channel.load.supply_current_a(now_s)
        if drawn_a > channel.limit_a:
            channel.constant_current = True
            channel.output_v *= channel.limit_a / drawn_a
            channel.load.set_supply(channel.output_v, now_s)

    def _channel(self, text: str) -> _Channel:
        (item,) = expression_items(text, 1)
        index = int(number(item, 0, 1e6))
        if not 1 <= index <= len(self._channels):
            raise ScpiError(-222, text[:40])
        return self._channels[index - 1]

    def _set_voltage(self, call: Call) -> None:
        value, where = call.exactly(2)
        channel = self._channel(where)
        channel.set_voltage_v = number(value, 0.0, MAX_VOLTAGE_V)
        self._drive(channel, call.now_s)

    def _set_limit(self, call: Call) -> None:
        value, where = call.exactly(2)
        channel = self._channel(where)
        channel.limit_a = number(value, 0.0, MAX_CURRENT_A)
        self._drive(channel, call.now_s)

    def _switch(self, call: Call) -> None:
        state, where = call.exactly(2)
        channel = self._channel(where)
        on = boolean(state)
        if on != channel.on:
            channel.on = on
            self._drive(channel, call.now_s)

    def _voltage_setting(self, call: Call) -> str:
        return formatted(self._channel(call.exactly(1)[0]).set_voltage_v)

    def _limit_setting(self, call: Call) -> str:
        return formatted(self._channel(call.exactly(1)[0]).limit_a)

    def _state(self, call: Call) -> str:
        return "1" if self._channel(call.exactly(1)[0]).on else "0"

    def _condition(self, call: Call) -> str:
        channel = self._channel(call.exactly(1)[0])
        self._limit(channel, call.now_s)
        return str(CONSTANT_CURRENT_BIT if channel.constant_current else 0)

    def _measure_voltage(self, call: Call) -> str:
        channel = self._channel(call.exactly(1)[0])
        self._limit(channel, call.now_s)
        return formatted(channel.voltage.of(channel.output_v, call.now_s))

    def _measure_current(self, call: Call) -> str:
        channel = self._channel(call.exactly(1)[0])
        self._limit(channel, call.now_s)
        drawn_a = channel.limit_a if channel.constant_current else channel.load.supply_current_a(call.now_s)
        return formatted(channel.current.of(drawn_a if channel.on else 0.0, call.now_s))
