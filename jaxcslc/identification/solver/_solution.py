import equinox as eqx


class RESULTS(eqx.Enumeration):
    """How a fit ended. The members are the messages."""

    successful = ""
    rank_deficient = (
        "The patterns do not determine every coefficient: `unidentifiable` names those that they"
        " cannot tell. Record motion that excites them, fix them at known values, or derive with"
        " lengths='numeric'."
    )
    no_equations = (
        "Fewer equations than coefficients are left after masking. Lower the velocity thresholds"
        " or record more motion."
    )
    nonfinite = "The patterns hold NaN or infinite numbers."
