"""glTF 2.0's reflectance, integrated naively: appendix B of the specification, written from its formulas alone."""

import numpy as np


def reflected(view, sky, *, color, metallic, roughness, steps=192):
    """Radiance (3,) towards `view` (3,), a unit vector with the normal along z, under `sky`: directions -> (..., 3).

    The diffuse part is a midpoint sum over directions l of equal projected solid angle; the specular part one over
    half-vectors h of equal D(h) cos(h), whose reflection of the view is l.
    """
    view, color, alpha = (
        np.asarray(view, float),
        np.asarray(color, float),
        max(roughness**2, 1e-3),
    )
    share = (np.arange(steps) + 0.5) / steps
    u, phi = np.meshgrid(share, 2 * np.pi * share, indexing="ij")

    def around(cosine):
        sine = np.sqrt(1 - cosine**2)
        return np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], axis=-1)

    light = around(np.sqrt(1 - u))
    half = light + view
    v_dot_h = (half / np.linalg.norm(half, axis=-1, keepdims=True)) @ view
    dielectric = (0.04 + 0.96 * (1 - v_dot_h) ** 5)[..., None]
    diffuse = (sky(light) * (1 - dielectric)).mean(axis=(0, 1)) * color

    half = around(np.sqrt((1 - u) / (1 + (alpha**2 - 1) * u)))
    v_dot_h = half @ view
    light = 2 * v_dot_h[..., None] * half - view
    seen = (v_dot_h > 0) & (light[..., 2] > 0)

    def masked(cosine):
        return 2 * cosine / (cosine + np.sqrt(alpha**2 + (1 - alpha**2) * cosine**2))

    visible = (
        masked(view[2])
        * masked(np.abs(light[..., 2]))
        * v_dot_h
        / (view[2] * half[..., 2])
    )
    weight = np.where(seen, visible, 0)[..., None] * sky(light)
    schlick = np.clip(1 - v_dot_h, 0, 1)[..., None] ** 5
    glossy = (weight * (0.04 + 0.96 * schlick)).mean(axis=(0, 1))
    metal = (weight * (color + (1 - color) * schlick)).mean(axis=(0, 1))
    return (1 - metallic) * (diffuse + glossy) + metallic * metal
