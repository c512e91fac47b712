import dataclasses


@dataclasses.dataclass(frozen=True)
class Finding:
    """One thing that looks wrong with a recording.

    **Attributes**

    - `kind`: what it is about, such as `"time unit"`, `"sign"` or `"torque lag"`.
    - `joint`: name of the joint, or of several; empty where it is about all of them.
    - `evidence`: a sentence with numbers.
    - `cause`: the likeliest one.
    - `remedy`: what to do about it, with the option of the command if there is one.
    - `recording`: name of the recording; empty where there is one.

    >>> from jaxcslc.identification import Finding
    >>> print(Finding("gap", "", "no sample for 3 s from 8.2 s on", "lost rows", "record again"))
    gap: no sample for 3 s from 8.2 s on. Likely cause: lost rows. Remedy: record again
    """

    kind: str
    joint: str
    evidence: str
    cause: str
    remedy: str
    recording: str = ""

    def __str__(self) -> str:
        where = ", ".join(part for part in (self.recording, self.kind, self.joint) if part)
        return f"{where}: {self.evidence}. Likely cause: {self.cause}. Remedy: {self.remedy}"
