"""One motion for a whole field: it is found, whatever else moves, and edges count across themselves."""

import types

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.dense.fields import MODELS, basis, check, fit_field
from cmfpga.errors import ConfigError
from support.flowing import OMEGA

CONFIG = preset("flow").replace(camera="200,190,118,92")
TRUE = {
    "translation": (40.0, -70.0),
    "similarity": (40.0, -70.0, 0.5, -0.8),
    "affine": (40.0, -70.0, 0.5, -0.3, 0.2, 0.9),
    "rotation": (0.3, -0.6, 0.9),
}


def made(model, rng, count=100, noise=0.0, sigma=(5.0, 5.0)):
    """A window as far as the fit looks at it: tiles with a known field, and noise of ``sigma`` px/s along x and y."""
    at = rng.uniform((0, 0), (239, 179), (count, 2))
    v = np.einsum("apn,p->na", basis(model, CONFIG, at), TRUE[model])
    v = v + noise * rng.standard_normal((count, 2)) * sigma
    covariance = np.tile((*np.square(sigma), 0.0), (count, 1))
    return types.SimpleNamespace(
        config=CONFIG, centres=at, px_per_s=v, uncertainty=covariance, sure=np.ones(count, bool),
        half_s=np.inf,  # then nothing is added to these
    )  # fmt: skip


@pytest.mark.parametrize("model", MODELS)
def test_a_field_without_noise_is_found_exactly(model, rng):
    found = fit_field(model, made(model, rng))
    assert found.values == pytest.approx(TRUE[model], rel=1e-6, abs=1e-6)
    assert len(MODELS[model]) == len(found.values) and found.tiles == 100 and found.agree == 1.0


@pytest.mark.parametrize("model", MODELS)
def test_a_quarter_that_moves_on_its_own_changes_little(model, rng):
    window = made(model, rng, noise=1.0)
    window.px_per_s[:25] += (300.0, 150.0)
    found = fit_field(model, window)
    assert (np.abs(found.values - TRUE[model]) < 6 * found.errors).all()
    assert found.agree < 0.8
    system = np.moveaxis(basis(model, CONFIG, window.centres), 2, 0).reshape(200, -1)
    plain = np.linalg.lstsq(system, window.px_per_s.ravel(), rcond=None)[0]
    assert np.abs(plain - TRUE[model]).max() > 4 * np.abs(found.values - TRUE[model]).max()


def test_errors_are_those_of_many_fits(rng):
    fits = [fit_field("similarity", made("similarity", rng, noise=1.0)) for _ in range(60)]
    scatter = np.std([one.values for one in fits], axis=0)
    told = np.mean([one.errors for one in fits], axis=0)
    assert (scatter < 1.6 * told).all() and (told < 2.2 * scatter).all()


def test_edges_count_across_themselves(rng):
    """Half of the tiles know their flow along x only, half along y only: together they know it all."""
    one, two = (made("translation", rng, 30, noise=1.0, sigma=s) for s in ((1.0, 400.0), (400.0, 1.0)))
    for name in ("centres", "px_per_s", "uncertainty", "sure"):
        setattr(one, name, np.concatenate([getattr(one, name), getattr(two, name)]))
    assert fit_field("translation", one).values == pytest.approx(TRUE["translation"], abs=2.0)


def test_too_little_to_fit(rng):
    window = made("affine", rng, 3)
    assert np.isnan(fit_field("affine", window).values).all()
    window = made("similarity", rng, 40)
    window.centres = np.tile(window.centres[:1], (40, 1))  # all in one place: neither zoom nor roll
    assert np.isnan(fit_field("similarity", window).values).all()
    window.sure[:] = False
    assert fit_field("translation", window).tiles == 0


def test_a_rotation_by_the_hardware(turned):
    assert np.linalg.norm(fit_field("rotation", turned).values - OMEGA) < np.radians(2) + 0.04 * np.linalg.norm(OMEGA)


def test_what_cannot_be_fitted():
    with pytest.raises(ConfigError, match="a calibration is needed"):
        check("rotation", preset("flow"))
    with pytest.raises(ConfigError, match="one of translation, similarity"):
        check("shear", CONFIG)
    check("rotation", CONFIG)
