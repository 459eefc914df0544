"""Naive reference: the three protocols pixel by pixel in plain Python, written from the evaluators' rules."""

import math

import numpy as np

INF = math.inf


def middlebury(disp, gt, mask, ndisp, rounded=False, scale=1):
    n = invalid = 0
    errors = []
    for y, row in enumerate(gt):
        for x, true in enumerate(row):
            if true == INF or not mask[y][x]:
                continue
            n += 1
            d = disp[y // scale][x // scale]
            if d == INF or d > 1000 * ndisp:
                invalid += 1
                continue
            d = max(0.0, min(float(scale * ndisp), scale * d))
            if rounded:
                d = float(int(d + 0.5))
            errors.append(abs(d - true))
    out = {"invalid": share(invalid, n), "coverage": share(n - invalid, n)}
    for t in (0.5, 1.0, 2.0, 4.0):
        bad = sum(1 for e in errors if e > t)
        out[f"bad{t}"], out[f"totbad{t}"] = share(bad, n), share(bad + invalid, n)
    return out | sizes(errors, math.nan)


def eth3d(disp, gt, mask):
    n, errors = 0, []
    width = len(gt[0])
    for y, row in enumerate(gt):
        for x, true in enumerate(row):
            if true == INF or not mask[y][x]:
                continue
            n += 1
            if abs(disp[y][x]) <= width:
                errors.append(abs(disp[y][x] - true))
    out = {"coverage": share(len(errors), n)}
    for t in (0.5, 1.0, 2.0, 4.0):
        out[f"bad{t}"] = (
            share(sum(1 for e in errors if e > t), len(errors)) if errors else 100.0
        )
    return out | sizes(errors, INF)


def kitti(disp, gt, mask):
    filled = [[-1.0 if d == INF else d for d in row] for row in fill(disp)]
    n = outliers = estimated = outliers_given = 0
    for y, row in enumerate(gt):
        for x, true in enumerate(row):
            if true == INF or not mask[y][x]:
                continue
            n += 1
            e = abs(np.float32(filled[y][x]) - np.float32(true))
            outlier = e > np.float32(3) and (
                true == 0 or float(e / abs(np.float32(true))) > 0.05
            )
            outliers += outlier
            if 0 <= disp[y][x] < INF:
                estimated += 1
                outliers_given += outlier
    return {
        "D1": share(outliers, n),
        "D1_est": share(outliers_given, estimated),
        "coverage": share(estimated, n),
    }


def fill(disp):
    rows = [[d if 0 <= d < INF else None for d in row] for row in disp]
    width, height = len(rows[0]), len(rows)
    for row in rows:
        places = [x for x in range(width) if row[x] is not None]
        if not places:
            continue
        for x in range(width):
            if row[x] is None:
                left = [row[k] for k in places if k < x][-1:]
                right = [row[k] for k in places if k > x][:1]
                row[x] = ("fill", min(left + right))
        row[:] = [d[1] if isinstance(d, tuple) else d for d in row]
    for x in range(width):
        places = [y for y in range(height) if rows[y][x] is not None]
        for y in range(height):
            if places and y < places[0]:
                rows[y][x] = rows[places[0]][x]
            if places and y > places[-1]:
                rows[y][x] = rows[places[-1]][x]
    return [[INF if d is None else d for d in row] for row in rows]


def sizes(errors, empty):
    ordered, n = sorted(errors), len(errors)
    out = {"avgerr": math.fsum(errors) / n if n else empty}
    out["rms"] = math.sqrt(math.fsum(e * e for e in errors) / n) if n else empty
    for q in (50, 90, 95, 99):
        out[f"A{q}"] = ordered[(n * q) // 100] if n else empty
    return out


def share(count, total):
    return 100.0 * count / total if total else math.nan
