"""Effects beside another program's output: those on channels alone, and those of the chain as they act there."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import ChannelTerm
from highside.physics.effect import Effect, LinearEffect
from highside.physics.state import ChainState


class ChannelEffect(Effect):
    """Acts on channels beside another program's output alone; `stage` says what it would be in a chain."""

    parameters = ()

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.zeros((3, state.n))


class OnChannels(LinearEffect):
    """An effect of the library as it acts on the channels at hand: its id, words and stage, parameters of theirs."""

    depends_on_input = False

    def __init__(self, effect: Effect, term: ChannelTerm | None = None) -> None:
        self.id, self.title, self.stage, self.formula = effect.id, effect.title, effect.stage, effect.formula
        self.story = effect.channel_story or effect.story
        self.confused_with, self.splitter = effect.confused_with, effect.splitter
        self.slow, self.constant = effect.slow, effect.constant
        self.parameters = () if term is None else term.parameters
        self.relinearised = term is not None and term.relinearised
        each = tuple((k,) for k in range(len(self.parameters)))
        self.groups = term.groups if term is not None and term.groups else each

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        # its columns are those of its term: there is no chain to act in
        return np.zeros((len(self.parameters), 3, state.n))
