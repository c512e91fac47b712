from ._arm_chart import ArmChart as ArmChart, Ellipsoid as Ellipsoid
from ._blocks import (
    TONES as TONES,
    AbstractBlock as AbstractBlock,
    Code as Code,
    Column as Column,
    Details as Details,
    Grid as Grid,
    Link as Link,
    Message as Message,
    Messages as Messages,
    Page as Page,
    Paragraph as Paragraph,
    Picture as Picture,
    Section as Section,
    Table as Table,
    Tone as Tone,
    Value as Value,
)
from ._chart import AbstractChart as AbstractChart
from ._curves import (
    Curve as Curve,
    envelope as envelope,
    intervals as intervals,
    plain as plain,
)
from ._film import Film as Film
from ._matrix_chart import MatrixChart as MatrixChart
from ._panel_chart import Panel as Panel, PanelChart as PanelChart
from ._render import render as render
