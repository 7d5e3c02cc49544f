"""Which terms of the equations a scene asks for, what each costs, and what leaving it out does."""

from multirod.studies.terms.explanation import Explanation, Term, explain
from multirod.studies.terms.simplify import Dropped, simplified

__all__ = ["Dropped", "Explanation", "Term", "explain", "simplified"]
