"""Analysis of recorded swings, and predictions to compare them with.

Public names:
    `swing.fit_swing`: period, damping and amplitude of a decaying swing.
    `swing.peaks`, `swing.swing_amplitude`, `swing.settling_time`: quantities read from a record.
    `swing.fit_power_law`: exponent of one quantity over another.
    `swing.agreement`: deviation of a model from a measurement.
    `prediction.free_swing`: period and amplitude of a free swing, predicted before it is measured.

Begin with `swing.fit_swing`.
"""
