"""The inverted film image against rays through the aperture."""

import numpy as np

from twinlens.camera import Camera, film_image


def test_film_image_is_where_the_ray_through_the_aperture_meets_the_film():
    camera = Camera(41, 31, 50.0, 50.0, 22.0, 13.0)
    point = np.array([0.12, -0.06, 1.0])
    u, v = np.rint(camera.project(point)).astype(int)
    upright = np.zeros((31, 41, 3))
    upright[v, u] = 1

    film = point * (
        -camera.film_distance / point[2]
    )  # straight on through the origin to z = -v
    right, down = np.rint(film[:2] / (camera.pixel_pitch_um * 1e-6)).astype(int)
    turned_centre = np.array([41 - 1 - 22, 31 - 1 - 13])
    rows, columns = np.nonzero(film_image(upright)[..., 0])
    assert [columns[0], rows[0]] == (turned_centre + np.array([right, down])).tolist()


def test_film_image_is_its_own_inverse():
    image = np.random.default_rng(0).random((5, 7, 3))
    assert (film_image(film_image(image)) == image).all()
    assert film_image(image).flags.c_contiguous
