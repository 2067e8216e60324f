"""The Hiera-UNet calibrator: a network that reads two hours of a record and corrects the twin's parameters and outputs.

Modules without torch: `windows`, `channels`, `features`, `regimes`, `evidence`, `campaigns`.
"""
