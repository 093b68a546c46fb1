"""What a text asks for, as far as it was read: its order and number, and the nouns of a phrase."""

from __future__ import annotations

from dataclasses import dataclass, field

from vlmm_log.queries import Order
from vlmm_log.query_tree import Node, both


@dataclass
class Asked:
    """What a text asks for beside its filter, as far as it was read."""

    order: Order | None = None
    limit: int | None = None
    returns: str = "objects"
    one: bool = True  # a superlative of a singular asks for one

    def takes(self, phrases: list[Phrase]) -> bool:
        """Take over what noun phrases ask for; False, with nothing taken, where that is asked for already."""
        own = [p.asked for p in phrases if p.asked != Asked()]
        orders, limits = [a.order for a in own if a.order], [a.limit for a in own if a.limit]
        if len(orders) + (self.order is not None) > 1 or len(limits) + (self.limit is not None) > 1:
            return False
        self.order, self.limit = self.order or next(iter(orders), None), self.limit or next(iter(limits), None)
        if any(a.returns == "mask" for a in own) and self.returns == "objects":
            self.returns = "mask"
        return True


@dataclass
class Phrase:
    """A noun phrase: its modifiers and its name."""

    nodes: list[Node] = field(default_factory=list)
    asked: Asked = field(default_factory=Asked)
    named: bool = False
    thing: str | None = None  # a word like "object": its value in the lexicon
    plural: bool = False
    determined: bool = False
    joint: str = ""  # what joins it to the phrase before

    @property
    def node(self) -> Node:
        """The filter."""
        return both(*self.nodes)
