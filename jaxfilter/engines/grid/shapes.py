"""Compiled passes over gridded surfaces: values from a triangulation, segments of level cells, and what lies around them."""

from __future__ import annotations

import numpy as np

from ..compiled import compiled


@compiled(allocates=True)
def draw(x, y, triangles, z, out, known):
    """Give the cells that are not ``known`` the elevations of a triangulation, linear within each triangle. On the edge of two
    the lower one counts, so that the order of triangles and of their corners changes nothing.

    Args:
        x, y: f64[k], positions of the nodes in cells; the centre of cell (row, column) is at (column, row).
        triangles: i32[t, 3]; rows with a negative corner are left out.
        z: f32[k], elevations of the nodes, metres.
        out: f32[rows, columns], written to; known: bool[rows, columns], set for the cells that have a value.
    """
    rows, columns = out.shape
    drawn = np.zeros(out.shape, np.bool_)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if min(a, b, c) < 0:
            continue
        while a > b or a > c:  # which corner is the first changes the rounding
            a, b, c = b, c, a
        ax, ay = x[a], y[a]
        ux, uy, vx, vy = x[b] - ax, y[b] - ay, x[c] - ax, y[c] - ay
        area = ux * vy - vx * uy
        if area <= 0:
            continue
        south, north = ay + min(0.0, uy, vy), ay + max(0.0, uy, vy)
        west, east = ax + min(0.0, ux, vx), ax + max(0.0, ux, vx)
        for row in range(max(0, int(np.ceil(south))), min(rows - 1, int(np.floor(north))) + 1):
            for column in range(max(0, int(np.ceil(west))), min(columns - 1, int(np.floor(east))) + 1):
                px, py = column - ax, row - ay
                s, r = px * vy - vx * py, ux * py - px * uy
                if s < 0 or r < 0 or (known[row, column] and not drawn[row, column]):
                    continue
                s, r = s / area, r / area
                if s + r <= 1:
                    level = np.float32(z[a] + s * (z[b] - z[a]) + r * (z[c] - z[a]))
                    if not drawn[row, column] or level < out[row, column]:
                        out[row, column] = level
                    known[row, column] = drawn[row, column] = True


@compiled
def root(parent, cell):
    """The cell that stands for a set: where the chain of parents ends, which gets shorter."""
    while parent[cell] != cell:
        parent[cell] = parent[parent[cell]]
        cell = parent[cell]
    return cell


@compiled(allocates=True)
def segments(z, step, least):
    """i32[rows, columns]: the 4-connected segments of cells whose elevations differ by less than ``step`` from one to the
    next; and how many have ``least`` cells or more. These are counted from 1 in the order of their first cells, row by row;
    cells of the others are 0. ``z``: f32[rows, columns]."""
    rows, columns = z.shape
    parent = np.arange(rows * columns, dtype=np.int32)
    for row in range(rows):
        for column in range(columns):
            cell = row * columns + column
            for beside in range(2):
                if beside == 0 and column > 0:
                    other, level = cell - 1, z[row, column - 1]
                elif beside == 1 and row > 0:
                    other, level = cell - columns, z[row - 1, column]
                else:
                    continue
                if abs(z[row, column] - level) < step:
                    a, b = root(parent, cell), root(parent, other)
                    parent[max(a, b)] = min(a, b)
    size, count = np.zeros(rows * columns, np.int32), 0
    for cell in range(rows * columns):
        parent[cell] = first = parent[parent[cell]]
        size[first] += 1
    for cell in range(rows * columns):
        first = parent[cell]
        if first == cell:
            count += 1 if size[cell] >= least else 0
            size[cell] = count if size[cell] >= least else 0
        parent[cell] = size[first]
    return parent.reshape(rows, columns), count


@compiled(allocates=True)
def falls(segment, z, seen, further):
    """f32[rows, columns]: how far the surface falls at the cells that have a cell of another segment beside them, metres: down to
    the lowest elevation within two rows and columns; zero for all others. bool[rows, columns]: those that are seen to be walls.

    It is negative on a face: there it falls ``further`` times as far at least within four rows and columns. At a wall it falls at
    once. Either is seen if half of these cells have points.

    Args:
        segment: i32[rows, columns], from :func:`segments`. z: f32[rows, columns], metres.
        seen: bool[rows, columns], cells with points. further: f32.
    """
    rows, columns = segment.shape
    fall, walls = np.zeros(segment.shape, np.float32), np.zeros(segment.shape, np.bool_)
    for row in range(rows):
        for column in range(columns):
            name, border = segment[row, column], False
            for side in range(4):
                r, c = row + (side == 0) - (side == 1), column + (side == 2) - (side == 3)
                border |= 0 <= r < rows and 0 <= c < columns and segment[r, c] != name
            if name == 0 or not border:
                continue
            near = far = z[row, column]
            cells = points = 0
            for r in range(max(0, row - 4), min(rows, row + 5)):
                for c in range(max(0, column - 4), min(columns, column + 5)):
                    cells, points, far = cells + 1, points + seen[r, c], min(far, z[r, c])
                    if abs(r - row) < 3 and abs(c - column) < 3:
                        near = min(near, z[r, c])
            at_once = z[row, column] - far < further * (z[row, column] - near)
            known = 2 * points >= cells
            fall[row, column] = near - z[row, column] if known and not at_once else z[row, column] - near
            walls[row, column] = known and at_once
    return fall, walls


@compiled(allocates=True)
def census(segment, count, fall, walls, slope, inside, drop, run, tall):
    """i32[6, 1 + count]: for each segment the numbers of its cells, of those on its border with others, of the latter where the
    surface falls, of these on faces, of those on its border at walls of more than f32 ``tall``, metres, and of its other cells at
    the edge of what is ``inside``; zero for the cells that are in none.

    Args:
        segment: i32[rows, columns], and how many there are, from :func:`segments`; inside: bool[rows, columns].
        fall, walls: from :func:`falls`; slope: f32[rows, columns], rise over run. The surface falls by more than f32 ``drop``,
            metres, and the slope times f32 ``run``, metres.
    """
    rows, columns = segment.shape
    found = np.zeros((6, count + 1), np.int32)
    for row in range(rows):
        for column in range(columns):
            name = segment[row, column]
            if name == 0:
                continue
            found[0, name] += 1
            border = edge = False
            for side in range(4):
                r, c = row + (side == 0) - (side == 1), column + (side == 2) - (side == 3)
                if 0 <= r < rows and 0 <= c < columns and inside[r, c]:
                    border |= segment[r, c] != name
                else:
                    edge = True
            falling = border and abs(fall[row, column]) > drop + run * slope[row, column]
            found[1, name] += border
            found[2, name] += falling
            found[3, name] += falling and fall[row, column] < 0
            found[4, name] += border and walls[row, column] and fall[row, column] > tall
            found[5, name] += edge and not border
    return found


@compiled(allocates=True)
def faces(segment, count, z, high, seen, whole, step, smooth, drop):
    """i32[6, 1 + count]: for each segment the numbers of its cells, of those that are ``whole``, of those that have points as
    their eight neighbours do, of the bare ones among these, of the cells on its border with cells of no segment, and of the
    latter that are walls; zero for the cells that are in none.

    A cell is bare if the surface rises there, by ``step`` from one cell to the next at least, its elevation is within ``smooth``
    of the middle of two opposite neighbours, and its highest point within ``smooth`` of what the slope explains. It is a wall if
    the surface falls farther outward than it rises inward, each within two cells, by more than ``drop``.

    Args:
        segment: i32[rows, columns], and how many there are. z, high: f32[rows, columns], lowest and highest points, metres.
        seen: bool[rows, columns], cells with points; whole: bool[rows, columns].
        step, smooth, drop: metres.
    """
    rows, columns = segment.shape
    found = np.zeros((6, count + 1), np.int32)
    for row in range(rows):
        for column in range(columns):
            name = segment[row, column]
            if name == 0:
                continue
            level, border, inside = z[row, column], False, 0
            outer, inner = np.inf, level
            for r in range(max(0, row - 2), min(rows, row + 3)):
                for c in range(max(0, column - 2), min(columns, column + 3)):
                    inside += abs(r - row) < 2 and abs(c - column) < 2 and seen[r, c]
                    if segment[r, c] == 0:
                        outer = min(outer, z[r, c])
                        border |= abs(r - row) + abs(c - column) == 1
                    elif segment[r, c] == name:
                        inner = max(inner, z[r, c])
            found[0, name] += 1
            found[1, name] += whole[row, column]
            if inside == 9:
                west, east = z[row, column - 1], z[row, column + 1]
                south, north = z[row - 1, column], z[row + 1, column]
                bent = min(abs(level - (west + east) / 2), abs(level - (south + north) / 2))
                for side in (-1, 1):
                    across = (z[row - 1, column - side] + z[row + 1, column + side]) / 2
                    bent = min(bent, abs(level - across) / np.sqrt(2.0))
                rise = np.hypot(east - west, north - south)  # over two cells, across one and its corners
                found[2, name] += 1
                found[3, name] += rise >= 2 * step and bent <= smooth and high[row, column] - level <= rise + smooth
            found[4, name] += border
            found[5, name] += border and (level - outer) - (inner - level) > drop
    return found


@compiled(allocates=True)
def banks(segment, count, z, drop, steepest, further, smooth):
    """i32[4, 1 + count]: for each segment the numbers of its cells, of the smooth ones among these, of those on its border with
    other cells where the surface falls, and of the latter on banks; zero for the cells that are in none.

    A cell is smooth if it is within ``smooth`` of the mean of itself and its eight neighbours. The surface falls if a cell within
    two rows and columns is lower by more than ``drop``. It is a bank if that is less than ``steepest``, and if it is ``further``
    times as much as within one row and column, or the surface rises as much within two.

    Args:
        segment: i32[rows, columns], from :func:`segments`. z: f32[rows, columns], metres.
        drop, steepest, smooth: f32, metres. further: f32.
    """
    rows, columns = segment.shape
    found = np.zeros((4, count + 1), np.int32)
    for row in range(rows):
        for column in range(columns):
            name, border = segment[row, column], False
            if name == 0:
                continue
            level = beside = near = top = z[row, column]
            total, cells = np.float32(0), 0
            for r in range(max(0, row - 2), min(rows, row + 3)):
                for c in range(max(0, column - 2), min(columns, column + 3)):
                    near, top = min(near, z[r, c]), max(top, z[r, c])
                    if abs(r - row) < 2 and abs(c - column) < 2:
                        beside = min(beside, z[r, c])
                        total, cells = total + z[r, c] - level, cells + 1
                        border |= segment[r, c] != name and (r == row or c == column)
            fall = level - near
            goes_on = fall >= further * (level - beside) or top - level >= fall
            found[0, name] += 1
            found[1, name] += abs(total) <= smooth * cells
            found[2, name] += border and fall > drop
            found[3, name] += border and drop < fall < steepest and goes_on
    return found


@compiled
def _edges(here, first, second, drop, out):
    """``out``, bool[columns]: whether the surface falls upright from f32 ``here`` to ``first``, and goes on to ``second``."""
    for c in range(len(here)):
        fall = here[c] - first[c]
        out[c] = (fall > drop) & (first[c] - second[c] < fall / np.float32(3))


@compiled(allocates=True)
def flanks(z, back, reach, drop):
    """i8[rows, columns], f32[rows, columns] twice: along which of 8 lines, counted from 1 on, the surface falls upright on both
    sides of a cell, 0 where along none; how many cells lie between these edges; and how many metres it falls at the lower one.

    It falls upright where it falls by more than ``drop`` within ``back`` cells, and in the next ones by less than a third of
    that. Edges count that have no other one between them, for cells that are as high as both, to ``drop`` / 2. Of several lines
    that counts whose edges are nearest to each other, ``reach`` cells at most. Beyond the grid nothing is known.

    Args:
        z: f32[rows, columns], metres. back, reach: cells. drop: metres.
    """
    pad = 2 * back
    rows, columns = z.shape[0] + 2 * pad, z.shape[1] + 2 * pad
    wide = np.full((rows, columns), np.float32(np.inf))
    for row in range(z.shape[0]):  # Numba takes seconds to compile one assignment to this part
        for column in range(z.shape[1]):
            wide[row + pad, column + pad] = z[row, column]
    across, width = np.zeros(wide.shape, np.int8), np.full(wide.shape, np.float32(reach))
    fall, half = np.zeros(wide.shape, np.float32), np.float32(drop / 2)
    edges = np.zeros((2, rows, columns), np.bool_)  # towards lower rows, and towards higher ones
    for turn in range(8):
        dy = (0, 1, 1, 2, 1, 2, 1, 1)[turn]
        dx = (1, 2, 1, 1, 0, -1, -1, -2)[turn]
        step = np.float32(np.sqrt(dy * dy + dx * dx))
        far = max(1, int(np.rint(back / step)))
        fy, fx = far * dy, far * dx
        west, east = max(0, 2 * fx), columns + min(0, 2 * fx)
        edges[:] = False
        if rows <= 2 * fy or east <= west:
            continue
        for row in range(2 * fy, rows):
            high, low = wide[row, west:east], wide[row - 2 * fy, west - 2 * fx : east - 2 * fx]
            middle = wide[row - fy, west - fx : east - fx]
            _edges(high, middle, low, drop, edges[0, row, west:east])
            _edges(low, middle, high, drop, edges[1, row - 2 * fy, west - 2 * fx : east - 2 * fx])
        for row in range(pad, rows - pad):
            for column in range(pad, columns - pad):
                if not edges[0, row, column]:
                    continue
                level, cells, r, c = wide[row, column], np.float32(1), row, column
                while cells < reach and wide[r, c] < np.inf and not edges[1, r, c]:
                    cells, r, c = cells + step, r + dy, c + dx
                    if edges[0, r, c] and not edges[1, r, c]:  # it is nearer to all that is beyond
                        break
                if cells >= reach or not edges[1, r, c]:
                    continue
                end, last = wide[r, c], (r, c)
                falls = level - wide[row - fy, column - fx], end - wide[r + fy, c + fx]
                while r >= row and (dy > 0 or c >= column):
                    apart = max(abs(level - wide[r, c]), abs(end - wide[r, c]))
                    if cells < width[r, c] and apart < half:
                        across[r, c], width[r, c], fall[r, c] = turn + 1, cells, min(falls[0], falls[1])
                    r, c = r - dy, c - dx
                for side in range(2):  # an edge may be several cells wide
                    sign, out, other = 2 * side - 1, cells + step, level if side else end
                    r, c = (last[0] + dy, last[1] + dx) if side else (row - dy, column - dx)
                    while edges[side, r, c]:
                        here = wide[r, c]
                        if out < width[r, c] and abs(here - other) < half:
                            own = here - wide[r + sign * fy, c + sign * fx]
                            across[r, c], width[r, c], fall[r, c] = turn + 1, out, min(own, falls[1 - side])
                        out, r, c = out + step, r + sign * dy, c + sign * dx
    inner = slice(pad, rows - pad), slice(pad, columns - pad)
    return across[inner], width[inner], fall[inner]


@compiled(allocates=True)
def levels(z, half, most):
    """f32[rows, columns]: the mean of the (2 ``half`` + 1)² cells around each cell whose highest is less than f32 ``most`` above
    the lowest, NaN for all others. ``z``: f32[rows, columns], metres; cells where it is infinite count nowhere."""
    rows, columns = z.shape
    mean = np.full(z.shape, np.float32(np.nan))
    low, high, total, cells = np.zeros((4, columns), np.float32)
    for row in range(rows):
        low[:], high[:], total[:], cells[:] = np.inf, -np.inf, 0, 0
        for r in range(max(row - half, 0), min(row + half + 1, rows)):
            for c in range(columns):
                here, known = z[r, c], z[r, c] < np.inf
                low[c], high[c] = min(low[c], here), max(high[c], here if known else -here)
                total[c], cells[c] = total[c] + (here if known else np.float32(0)), cells[c] + known
        for column in range(columns):
            if z[row, column] < np.inf and high[column] - low[column] < most:
                bottom, top, sum, n = low[column], high[column], np.float64(0), np.float32(0)
                for c in range(max(column - half, 0), min(column + half + 1, columns)):
                    bottom, top = min(bottom, low[c]), max(top, high[c])
                    sum, n = sum + total[c], n + cells[c]
                if top - bottom < most:
                    mean[row, column] = sum / n
    return mean


@compiled(allocates=True)
def rims(segment, count, level, z, weight, away, rise):
    """f64[3, 1 + count]: for each segment the number of cells that are ``away`` cells from it, straight out; of those that are
    higher than its ``level`` by more than f32 ``rise``, less those that are lower by as much; and the sum of their ``weight``.

    Args:
        segment: i32[rows, columns], from :func:`segments`. level, z: f32[rows, columns], metres, ``z`` infinite where not known.
        weight: [rows, columns].
    """
    rows, columns = segment.shape
    found = np.zeros((3, count + 1))
    for row in range(rows):
        for column in range(columns):
            name = segment[row, column]
            for side in range(4 if name > 0 else 0):
                dy, dx = (side == 0) - (side == 1), (side == 2) - (side == 3)
                r, c = row + away * dy, column + away * dx
                if r < 0 or r >= rows or c < 0 or c >= columns or segment[row + dy, column + dx] == name:
                    continue
                if segment[r, c] != name and z[r, c] < np.inf:
                    found[0, name] += 1
                    higher = z[r, c] - level[row, column]
                    found[1, name] += (higher > rise) - (higher < -rise)
                    found[2, name] += weight[r, c]
    return found
