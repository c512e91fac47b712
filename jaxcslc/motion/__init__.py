from ._alignment import TorqueAlignment as TorqueAlignment, align_torque as align_torque
from ._clock import (
    resample as resample,
    restore_clock as restore_clock,
    uniform_interval as uniform_interval,
)
from ._filters import (
    Butterworth as Butterworth,
    CentralDifferences as CentralDifferences,
    SavitzkyGolay as SavitzkyGolay,
)
from ._masks import (
    away_from_reversals as away_from_reversals,
    friction_mask as friction_mask,
    friction_thresholds as friction_thresholds,
    possible_backlash as possible_backlash,
    static_fractions as static_fractions,
)
from ._patterns import (
    Patterns as Patterns,
    joined_patterns as joined_patterns,
)
from ._preparation import (
    DEFAULT_THRESHOLD_FRACTION as DEFAULT_THRESHOLD_FRACTION,
    Preparation as Preparation,
    VelocitySource as VelocitySource,
)
from ._prepare import as_recorded as as_recorded, prepare as prepare
from ._recording import (
    MINIMUM_SAMPLES as MINIMUM_SAMPLES,
    Fault as Fault,
    Recording as Recording,
    RecordingError as RecordingError,
    as_columns as as_columns,
    column_names as column_names,
    first_fault as first_fault,
    fresh_rows as fresh_rows,
    stale_rows as stale_rows,
    without_stale_rows as without_stale_rows,
)
from ._residual_thresholds import (
    StaticFriction as StaticFriction,
    thresholds_from_residuals as thresholds_from_residuals,
)
from ._rest import at_rest as at_rest, directions_beside as directions_beside
from ._sampling import (
    Sampling as Sampling,
    encoder_resolution as encoder_resolution,
    noise_level as noise_level,
    sixth_differences as sixth_differences,
)
from ._sections import Reversal as Reversal, find_reversals as find_reversals
from ._smoothing import (
    AbstractSmoothing as AbstractSmoothing,
    Derivatives as Derivatives,
    register_smoothing as register_smoothing,
    smoothing_document as smoothing_document,
    smoothing_from as smoothing_from,
    without_rounding as without_rounding,
)
from ._spacing import choose_spacing as choose_spacing, left_out_error as left_out_error
from ._splines import AveragedSplines as AveragedSplines
from .files import (
    ColumnMapping as ColumnMapping,
    RecordingChunk as RecordingChunk,
    iterate_recording as iterate_recording,
    load_columns as load_columns,
    load_recording as load_recording,
    load_recordings as load_recordings,
    save_recording as save_recording,
)
from .low_pass import (
    FilteredEquations as FilteredEquations,
    decimated_low_pass as decimated_low_pass,
    decimation_for as decimation_for,
    parallel_filter as parallel_filter,
    zero_phase as zero_phase,
)
