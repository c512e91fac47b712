import equinox as eqx


class OUTCOMES(eqx.Enumeration):
    """How a training ended. The members are the messages."""

    reached = ""
    no_further_reduction = ""
    stop_set = ""
    running = (
        "The training has not ended: it used up its epochs. Give it more, or end it by a target"
        " or a least reduction."
    )
    diverged = (
        "The training diverged: the cost grew beyond all bounds or became NaN. Start with smaller"
        " rates; the weights are those of the lowest cost."
    )
    stalled = (
        "The training stalled: no new lowest cost for as many epochs as `patience` says. The rates"
        " may be too large to settle, or too small to move."
    )


ENDINGS = {
    "reached the target": OUTCOMES.reached,
    "no further reduction": OUTCOMES.no_further_reduction,
    "stop set": OUTCOMES.stop_set,
    "not ended": OUTCOMES.running,
    "diverged": OUTCOMES.diverged,
    "stalled": OUTCOMES.stalled,
}
