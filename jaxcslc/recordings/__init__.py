"""Recordings of motion and torque, and their preparation for a fit.

`load_recording` reads a file. `prepare` and `Preparation` turn the recording into `Patterns`:
smoothed motion, torque, and masks of joint-and-sample pairs.

     file --> Recording --> clock ------> smoothing ---> masks ----> Patterns --> fits
              (files)       (times of     (q, qd, qdd)   (backlash,
                            q, torque)                    slow pairs)

Modules, in reading order:

- `files`: readers and writers of recording files.
- `_recording`: the recording, and faults that none may have.
- `_sampling`: interval, encoder resolution and noise of a recording.
- `_clock`: times of samples, resampling, and the torque that belongs to a sample.
- `_smoothing`, `_splines`: smoothing and differentiation; where joints turn round.
- `_low_pass`: zero-phase filters, and the filtering of whole equations.
- `_masks`: pairs that a fit leaves out, and when joints are at rest.
- `_preparation`: settings, and the patterns that they give.
"""

from ._clock import (
    TorqueAlignment as TorqueAlignment,
    align_torque as align_torque,
    resample as resample,
    restore_clock as restore_clock,
)
from ._low_pass import (
    FilteredEquations as FilteredEquations,
    decimated_low_pass as decimated_low_pass,
    decimation_for as decimation_for,
    parallel_filter as parallel_filter,
    samples_kept as samples_kept,
    zero_phase as zero_phase,
)
from ._masks import (
    at_rest as at_rest,
    away_from_reversals as away_from_reversals,
    directions_beside as directions_beside,
    friction_mask as friction_mask,
    friction_thresholds as friction_thresholds,
    possible_backlash as possible_backlash,
    resting_range as resting_range,
    static_fractions as static_fractions,
    without_motion_at_rest as without_motion_at_rest,
)
from ._preparation import (
    DEFAULT_THRESHOLD_FRACTION as DEFAULT_THRESHOLD_FRACTION,
    Patterns as Patterns,
    Preparation as Preparation,
    VelocitySource as VelocitySource,
    joined_patterns as joined_patterns,
    prepare as prepare,
)
from ._recording import (
    MINIMUM_SAMPLES as MINIMUM_SAMPLES,
    Recording as Recording,
    RecordingError as RecordingError,
    as_float as as_float,
    check_quantities as check_quantities,
    check_samples as check_samples,
    fresh_rows as fresh_rows,
    stale_rows as stale_rows,
    without_repetition as without_repetition,
    without_stale_rows as without_stale_rows,
)
from ._sampling import (
    NORMAL_MEDIAN as NORMAL_MEDIAN,
    UNIFORM_TO as UNIFORM_TO,
    Sampling as Sampling,
    encoder_resolution as encoder_resolution,
    noise_level as noise_level,
    sixth_differences as sixth_differences,
    uniform_interval as uniform_interval,
)
from ._smoothing import (
    AbstractSmoothing as AbstractSmoothing,
    Butterworth as Butterworth,
    CentralDifferences as CentralDifferences,
    Derivatives as Derivatives,
    SavitzkyGolay as SavitzkyGolay,
    register_smoothing as register_smoothing,
    smoothing_document as smoothing_document,
    smoothing_from as smoothing_from,
    without_rounding as without_rounding,
)
from ._splines import (
    AveragedSplines as AveragedSplines,
    Reversal as Reversal,
    choose_spacing as choose_spacing,
    find_reversals as find_reversals,
    left_out_error as left_out_error,
    spline_derivatives as spline_derivatives,
)
from .files import (
    ColumnMapping as ColumnMapping,
    CommandTable as CommandTable,
    RecordingChunk as RecordingChunk,
    column_names_of as column_names_of,
    commands_of as commands_of,
    guessed_mapping as guessed_mapping,
    iterate_recording as iterate_recording,
    load_columns as load_columns,
    load_commands as load_commands,
    load_recording as load_recording,
    load_recordings as load_recordings,
    mapping_by_values as mapping_by_values,
    save_recording as save_recording,
)


__all__ = [
    "DEFAULT_THRESHOLD_FRACTION",
    "MINIMUM_SAMPLES",
    "AbstractSmoothing",
    "AveragedSplines",
    "Butterworth",
    "CentralDifferences",
    "ColumnMapping",
    "Derivatives",
    "FilteredEquations",
    "Patterns",
    "Preparation",
    "Recording",
    "RecordingChunk",
    "RecordingError",
    "Reversal",
    "Sampling",
    "SavitzkyGolay",
    "TorqueAlignment",
    "VelocitySource",
    "align_torque",
    "at_rest",
    "away_from_reversals",
    "choose_spacing",
    "decimated_low_pass",
    "decimation_for",
    "directions_beside",
    "encoder_resolution",
    "find_reversals",
    "fresh_rows",
    "friction_mask",
    "friction_thresholds",
    "iterate_recording",
    "joined_patterns",
    "left_out_error",
    "load_columns",
    "load_recording",
    "load_recordings",
    "noise_level",
    "parallel_filter",
    "possible_backlash",
    "prepare",
    "register_smoothing",
    "resample",
    "restore_clock",
    "save_recording",
    "sixth_differences",
    "smoothing_document",
    "smoothing_from",
    "stale_rows",
    "static_fractions",
    "uniform_interval",
    "without_motion_at_rest",
    "without_repetition",
    "without_rounding",
    "without_stale_rows",
    "zero_phase",
]
