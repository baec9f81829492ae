"""The variants of the baselines that are tried, and how they are told."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

from missions.trials.rivals.score import Rule
from path.baselines.association import BaselineConfig, Scope
from path.baselines.features import FeatureSearch
from path.baselines.matching import MatchConfig, Model

MODELS: tuple[Model, ...] = ("affine", "homography")
REACHES_PX = (2.0, 8.0)
SCOPES: tuple[Scope, ...] = ("each", "all")


def _variants(
    looks: tuple[FeatureSearch, ...],
    ratios: tuple[float, ...],
    plain: MatchConfig,
) -> tuple[BaselineConfig, ...]:
    """All looks with all ratios, models, reaches and scopes."""
    return tuple(
        BaselineConfig(look, replace(plain, ratio=ratio, model=model, reach_px=reach), scope)
        for look, ratio, model, reach, scope in product(looks, ratios, MODELS, REACHES_PX, SCOPES)
    )


def same_look(variants: tuple[BaselineConfig, ...], chosen: int) -> tuple[int, ...]:
    """Numbers of the variants that look for features as a chosen one does."""
    return tuple(i for i, each in enumerate(variants) if each.look == variants[chosen].look)


ORB_VARIANTS = _variants(
    (FeatureSearch(1.0), FeatureSearch(2.0), FeatureSearch(2.0, 0.2), FeatureSearch(3.0)),
    (0.75, 0.85, 0.95),
    MatchConfig(max_hamming=80),
)
XFEAT_VARIANTS = _variants(
    (FeatureSearch(2.0), FeatureSearch(1.0), FeatureSearch(1.0, 0.2)),
    (0.8, 0.9, 0.95),
    MatchConfig(),
)


def told(variants: tuple[BaselineConfig, ...], rule: Rule) -> dict[str, str | float]:
    """A rule in plain words and numbers."""
    chosen = variants[rule.variant]
    return {
        "zoom": chosen.look.zoom,
        "context": chosen.look.context,
        "ratio": chosen.match.ratio,
        "model": chosen.match.model,
        "reach_px": chosen.match.reach_px,
        "scope": chosen.scope,
        "min_inliers": rule.min_inliers,
        "min_lead": rule.min_lead,
    }


def sentence(variants: tuple[BaselineConfig, ...], rule: Rule) -> str:
    told_ = told(variants, rule)
    context = f" with {told_['context']:g} of its size around it" if told_["context"] else ""
    against = "each box by itself" if told_["scope"] == "each" else "all boxes together"
    return (
        f"image enlarged {told_['zoom']:g} times{context}, ratio {told_['ratio']:g} against {against}, "
        f"{told_['model']} within {told_['reach_px']:g} px, at least {told_['min_inliers']} matches and "
        f"{told_['min_lead']} more than any other box"
    )
