"""Benchmarks: reproducible measurements of speed, fits and the paper's experiments, with those of peers.

A benchmark returns a `Report` of tables; the command prints it and, when asked to, writes it with a manifest.
"""

from __future__ import annotations

__all__ = ["BENCHMARKS", "EXPERIMENTS", "RIGS"]

BENCHMARKS = {
    "twin": "One ten-minute window of the coolant loop: our kernel, scipy, numpy, torch, jax, C",
    "fit": "The same windows fitted by our calibrators and by other people's optimisers",
    "paper": "The experiments of Energies 2026, 19, 2452, with its figures",
    "posterior": "Intervals of the calibrators against a posterior by Markov chain Monte Carlo",
    "hiera": "Calibrators on unseen rigs: swarm, least squares, filter, network",
    "ablations": "Ablations of the network, each with the same CPU time of training",
    "audit": "Known causes of the network's blindness, each measured on simulated plants before any training",
    "discovery": "Blind trial of the diagnosis: hidden effects, sealed answers",
    "again": "A revised twin on later records: no new effect, and a second effect",
    "zoo": "Diagnosis of random plants unlike any twin, with hidden effects of many kinds and sealed answers",
    "effects": "Unmodelled effects of random plants, found within twenty minutes: a network and a linear rival",
    "faults": "Faults of wires, rig and harness: heater safe, no sample lost, no wrong value believed",
    "loop": "Jitter of the loop, its memory over 40 hours, and the losses of a killed run",
    "structure": "Commissioned twins of four and of ten volumes on healthy rigs of another maker",
    "bus": "Round trips of the Modbus driver and of other clients; bus time of forty hours in lockstep",
    "wire": "Mutated Modbus replies and CAN frames: no wrong value is accepted as good",
    "files": "Mutated files of every kind: each is read, or refused in a sentence that names it",
    "tower": "Calibrations of a cooling tower's outlet on a record: commissioned, persistence, regression, learned",
    "tower-governance": "Ramp of the fill, cleaning of nozzles, gates, proposals and alarms as a calibration goes on",
    "tower-rivals": "Other networks, ablations and a remedy on the tower's windows, each with the same processor time",
    "tower-rows": "Acceptance rows of the tower paper: its figure, our gate, our figure, reached or not",
    "fleet": "Diagnoses of many records on one worker and on two, and the cost of handing a job out",
    "sinks": "Streams, alarms and panel beside a run at 10 Hz, twenty viewers, exports of 40 hours",
    "records": "Public records of other rigs, with the published figures",
}
"""Name -> one line; each is a subcommand of `hil bench`."""
EXPERIMENTS = ("tracking", "randomised", "modules_heat", "tank_insulation")
"""Experiments of `hil bench paper`."""
RIGS = ("virtual", "stranger", "inverse")
"""Rigs of the paper's experiments; see `hil.bench.experiments.campaigns`."""
