from ._held_out import (
    HeldOut as HeldOut,
    RelativeError as RelativeError,
    cross_validated_error as cross_validated_error,
    held_out_error as held_out_error,
)
from ._identify import identify as identify
from ._identify_payload import identify_payload as identify_payload
from ._offline import fit_payload as fit_payload
from ._payload_fit import PHYSICAL as PHYSICAL, PayloadFit as PayloadFit
from ._reidentification import reidentify as reidentify
from ._settings import (
    Settings as Settings,
    settings_document as settings_document,
    settings_from as settings_from,
)
from ._torque_constants import (
    TorqueConstants as TorqueConstants,
    fit_torque_constants as fit_torque_constants,
    identify_torque_constants as identify_torque_constants,
)
from .checks import (
    DataCheck as DataCheck,
    Finding as Finding,
    TorqueLag as TorqueLag,
    check as check,
    estimate_torque_lag as estimate_torque_lag,
    without_outliers as without_outliers,
)
from .cluster import (
    Fleet as Fleet,
    fit_fleet_on_cluster as fit_fleet_on_cluster,
    fit_on_cluster as fit_on_cluster,
)
from .estimators import ESTIMATORS as ESTIMATORS, AbstractEstimator as AbstractEstimator
from .friction import (
    LoadFit as LoadFit,
    PreSlidingFit as PreSlidingFit,
    SlopeFit as SlopeFit,
    fit_load as fit_load,
    fit_pre_sliding as fit_pre_sliding,
    fit_slopes as fit_slopes,
    pre_sliding as pre_sliding,
    regress_friction as regress_friction,
)
from .instruments import (
    AbstractSimulatedMotion as AbstractSimulatedMotion,
    ControlledMotion as ControlledMotion,
    CorrectedMotion as CorrectedMotion,
    DirectDynamics as DirectDynamics,
    ExogeneityTest as ExogeneityTest,
    InstrumentalVariables as InstrumentalVariables,
    SimulationFit as SimulationFit,
)
from .likelihood import (
    Estimator as Estimator,
    EstimatorComparison as EstimatorComparison,
    LikelihoodFit as LikelihoodFit,
    MaximumLikelihood as MaximumLikelihood,
    Misfit as Misfit,
    NoiseExcitation as NoiseExcitation,
    SpacingChoice as SpacingChoice,
    TorqueSampling as TorqueSampling,
    Transmission as Transmission,
)
from .possible import (
    POSSIBILITY as POSSIBILITY,
    PhysicalParameters as PhysicalParameters,
    PossibleFit as PossibleFit,
    physical_parameters as physical_parameters,
)
from .prediction import HorizonError as HorizonError, prediction_error as prediction_error
from .prior import Known as Known, Prior as Prior, load_prior as load_prior
from .report import (
    DerivationReport as DerivationReport,
    ErrorTable as ErrorTable,
    Excitation as Excitation,
    PayloadReport as PayloadReport,
    Report as Report,
    ReportComparison as ReportComparison,
    Verdict as Verdict,
    coefficient_rows as coefficient_rows,
    coefficient_text as coefficient_text,
    compare as compare,
    compare_reports as compare_reports,
    degree_of_excitation as degree_of_excitation,
    load_report as load_report,
    load_settings as load_settings,
    predicted_torque as predicted_torque,
    torque_errors as torque_errors,
    verdicts as verdicts,
)
from .selection import (
    Candidates as Candidates,
    FrictionChoice as FrictionChoice,
    FrictionTrial as FrictionTrial,
    Selection as Selection,
    Trial as Trial,
    choose_friction as choose_friction,
    choose_settings as choose_settings,
)
from .several import (
    RecordingAgreement as RecordingAgreement,
    SeveralFit as SeveralFit,
    fit_recordings as fit_recordings,
)
from .solver import (
    RESULTS as RESULTS,
    Errors as Errors,
    Fixed as Fixed,
    Identification as Identification,
    JointWeights as JointWeights,
    LeastSquares as LeastSquares,
    Loss as Loss,
    Previous as Previous,
    shard_patterns as shard_patterns,
)
from .systematic import (
    SystematicError as SystematicError,
    standard_uncertainty as standard_uncertainty,
    systematic_error as systematic_error,
    uncertainty_interval as uncertainty_interval,
)
