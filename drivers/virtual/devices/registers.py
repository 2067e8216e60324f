"""Memory and safety logic of the PLC: register map, arming, heartbeat watchdog, thermostat. No I/O.

Holding registers: 0 heater_power_set 0.1 W; 1 pump_speed_set 0.1 %; 2 fan_speed_set 0.1 %; 3 heartbeat;
4 watchdog_timeout 0.1 s; 5 arm. Input registers: 0-1 heater_power float32 CDAB W; 2-3 flow float32 CDAB L/min;
4 pump_speed 0.1 %; 5 fan_speed 0.1 %; 6 T_ambient int16 0.01 degC; 7 status; 8-9 uptime uint32 ms, high word first;
10 heartbeat_echo; 11 cycle counter. Discrete inputs 0-2 mirror the status bits; coil 0 is arm.
"""

import struct
from collections.abc import Callable, Sequence

from drivers.virtual.devices.modbus_protocol import (
    ILLEGAL_ADDRESS,
    ILLEGAL_VALUE,
    BitTable,
    RefusedRequest,
    RegisterTable,
)

HEATER_SET, PUMP_SET, FAN_SET, HEARTBEAT, WATCHDOG, ARM = range(6)
HOLDING_COUNT = 6
INPUT_COUNT = 12
COIL_COUNT = 1

ARMED, WATCHDOG_TRIPPED, THERMOSTAT_TRIPPED = 1, 2, 4
STATUS_BITS = 3

HIGHEST = (10000, 1000, 1000, 0xFFFF, 0xFFFF, 1)
LOWEST = (0, 0, 0, 0, 10, 0)
DEFAULT_WATCHDOG = 100
THERMOSTAT_C = 75.0

_INPUTS = struct.Struct(">HHHHHHhHIHH")
_FLOAT = struct.Struct(">f")
_WORDS = struct.Struct(">HH")


class Registers:
    """Holding and input registers as big-endian bytes, ready for the wire, and the interlocks behind them."""

    def __init__(self) -> None:
        self.holding = [0, 0, 0, 0, DEFAULT_WATCHDOG, 0]
        self.inputs = bytes(2 * INPUT_COUNT)
        self.status = 0
        self._alive_at = 0.0
        self._needs_heartbeat = False
        self.now = 0.0
        """Rig time in s of the last period."""
        self._started = 0.0
        self.on_write: Callable[[], None] = lambda: None
        """Called after every write that was accepted."""

    def restart(self) -> None:
        """Set the state after a power cut: memory is lost, outputs are off, the clock begins anew."""
        self.holding = [0, 0, 0, 0, DEFAULT_WATCHDOG, 0]
        self.status = 0
        self._needs_heartbeat = False
        self._started = self.now

    @property
    def heater_W(self) -> float:
        """Set-point that reaches the heater, W: zero until armed."""
        return self.holding[HEATER_SET] * 0.1 if self.status & ARMED else 0.0

    @property
    def pump_fraction(self) -> float:
        """Pump set-point as fraction of full speed."""
        return self.holding[PUMP_SET] * 0.001

    @property
    def fan_fraction(self) -> float:
        """Fan set-point as fraction of full speed."""
        return self.holding[FAN_SET] * 0.001

    def write(self, first: int, values: Sequence[int]) -> bool:
        """Write holding registers; False (and nothing applied) when one of the values is refused.

        The heartbeat counts before the arm register, so one request may carry both.
        """
        fresh = self._needs_heartbeat
        for address, value in enumerate(values, first):
            if not LOWEST[address] <= value <= HIGHEST[address]:
                return False
            if address == HEARTBEAT and value != self.holding[HEARTBEAT]:
                fresh = False
            elif address == ARM and value == 1 and fresh:
                return False
        last = first + len(values)
        if first <= HEARTBEAT < last and values[HEARTBEAT - first] != self.holding[HEARTBEAT]:
            self._alive_at = self.now
            self._needs_heartbeat = False
        arm = values[ARM - first] if first <= ARM < last else None
        self.holding[first:last] = values
        if arm == 1 and not self.status & ARMED:
            self.status = ARMED
            self._alive_at = self.now
        elif arm == 0:
            self.status &= ~ARMED
        self.on_write()
        return True

    def read_registers(self, table: RegisterTable, first: int, count: int) -> bytes:
        """Return registers, big-endian; raise RefusedRequest."""
        _require(first, count, INPUT_COUNT if table == "input" else HOLDING_COUNT)
        if table == "input":
            return self.inputs[2 * first : 2 * (first + count)]
        return struct.pack(f">{count}H", *self.holding[first : first + count])

    def read_bits(self, table: BitTable, first: int, count: int) -> int:
        """Return the arming coil or the status bits, the first one as bit 0; raise RefusedRequest."""
        _require(first, count, COIL_COUNT if table == "coil" else STATUS_BITS)
        bits = (self.status & ARMED) if table == "coil" else self.status
        return (bits >> first) & ((1 << count) - 1)

    def write_registers(self, first: int, values: Sequence[int]) -> None:
        """Write holding registers; raise RefusedRequest."""
        _require(first, len(values), HOLDING_COUNT)
        if not self.write(first, values):
            raise RefusedRequest(ILLEGAL_VALUE)

    def write_bits(self, first: int, values: Sequence[int]) -> None:
        """Write the arming coil; raise RefusedRequest."""
        _require(first, len(values), COIL_COUNT)
        if not self.write(ARM, values):
            raise RefusedRequest(ILLEGAL_VALUE)

    def supervise(self, now: float, heater_water_C: float) -> None:
        """Run the interlocks at rig time `now` in s: a trip cuts the heater, clears its set-point and disarms."""
        self.now = now
        if not self.status & ARMED:
            return
        if heater_water_C > THERMOSTAT_C:
            self._trip(THERMOSTAT_TRIPPED)
        elif now - self._alive_at > self.holding[WATCHDOG] * 0.1 + 1e-6:
            self._trip(WATCHDOG_TRIPPED)

    def _trip(self, bit: int) -> None:
        self.status = (self.status & ~ARMED) | bit
        self.holding[HEATER_SET] = 0
        self.holding[ARM] = 0
        self._needs_heartbeat = True

    def publish(self, readings: Sequence[float], cycle: int) -> None:
        """Pack the input registers. `readings`: ambient degC, heater W, flow L/min, pump %, fan %."""
        ambient, power, flow, pump, fan = readings
        power_high, power_low = _WORDS.unpack(_FLOAT.pack(power))
        flow_high, flow_low = _WORDS.unpack(_FLOAT.pack(flow))
        self.inputs = _INPUTS.pack(
            power_low,
            power_high,
            flow_low,
            flow_high,
            min(max(round(pump * 10.0), 0), 0xFFFF),
            min(max(round(fan * 10.0), 0), 0xFFFF),
            min(max(round(ambient * 100.0), -32768), 32767),
            self.status,
            round((self.now - self._started) * 1000.0) & 0xFFFFFFFF,
            self.holding[HEARTBEAT],
            cycle & 0xFFFF,
        )


def _require(first: int, count: int, size: int) -> None:
    if first + count > size:
        raise RefusedRequest(ILLEGAL_ADDRESS)
