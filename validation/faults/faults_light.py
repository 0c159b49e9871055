"""Faults in light transport and in the ground truth."""

from __future__ import annotations

from .fault import ENERGY, Fault

SUN = ("house",)
LAMPS = ("two-rooms", "cornell")
PERCENT = (0.03, 0.01, 0.003, 0.001)

LIGHT: tuple[Fault, ...] = (
    Fault(
        "exitance-without-pi", "emitters shine with their radiance where their exitance, π times that, is meant",
        "reference/transport/patches.py", "emission = np.pi * np.stack(", "emission = np.stack(",
    ),
    Fault(
        "last-bounce-without-albedo", "the last bounce reflects all light, whatever the albedo",
        "reference/transport/radiosity.py", "b = p.exitance + p.albedo * incident", "b = p.exitance + incident",
    ),
    Fault(
        "source-without-albedo", "patches reflect direct light whole",
        "reference/transport/radiosity.py", "p.exitance + p.albedo * (direct + from_sky)", "p.exitance + (direct + from_sky)",
        LAMPS,
    ),
    Fault(
        "bounces-without-albedo-of-blue", "blue light is reflected with the albedo of green",
        "reference/transport/solver_types.py", "np.asarray(self.albedo * self.product(light)", 'np.asarray(self.albedo[:, [0, 1, 1]] * self.product(light)', ("two-rooms", "cornell", "corridor"),
    ),
    Fault(
        "colours-swapped", "red and blue of the albedo are swapped in the last bounce",
        "reference/transport/radiosity.py", "b = p.exitance + p.albedo * incident", "b = p.exitance + p.albedo[:, ::-1] * incident",
        ("two-rooms", "cornell", "corridor"),
    ),
    Fault(
        "solver-stops-early", "the solver stops a hundred times too early",
        "reference/transport/radiosity.py", "solve_system(system, method, tolerance, spectrum=spectrum)",
        "solve_system(system, method, min(100 * tolerance, 0.5), spectrum=spectrum)",
    ),
    Fault(
        "bounces-lost", "what receivers see reflects direct light alone: further bounces are lost",
        "reference/transport/radiosity.py", "light=np.concatenate([b, seen_sky", "light=np.concatenate([p.exitance + p.albedo * direct, seen_sky",
    ),
    Fault(
        "emitters-dark-to-probes", "receivers are lit by what patches reflect, not by what they emit",
        "reference/transport/radiosity.py", "light=np.concatenate([b, seen_sky", "light=np.concatenate([b - p.exitance, seen_sky",
        ("sphere", "corridor"),
    ),
    Fault(
        "sky-without-pi", "patches see the sky's radiance where π times it is meant",
        "reference/transport/radiosity.py", "np.zeros((p.count, 3)), np.pi * bin_radiance(smooth))", "np.zeros((p.count, 3)), bin_radiance(smooth))", SUN,
    ),
    Fault(
        "sky-dark-to-probes", "probes do not see the sky",
        "reference/transport/radiosity.py", "np.zeros_like(sky) if engine_sky else sky", "np.zeros_like(sky)", SUN,
    ),
    Fault(
        "transposed-rows", "form factors are divided by the other patch's area: F is transposed",
        "reference/transport/flows.py", "        values[at, 0] = x[which] / np.repeat(area, length)", "        values[at, 0] = x[which] / area[column]" " if int(column.max(initial=0)) < p else x[which] / np.repeat(area, length)",
    ),
    Fault(
        "rows-not-closed", "rows of form factors are left as rays found them, not closed",
        "reference/transport/reconcile.py", "    flows = closed(flows, area)\n", "",
    ),
    Fault(
        "one-way-only", "a pair's flow is what one of the two patches sees",
        "reference/transport/flows.py", "x = w_lo * flow.real + w_hi * flow.imag", "x = flow.real",
    ),
    Fault(
        "sides-swapped", "rays that meet the front of a patch see its back",
        "reference/transport/hits.py", "+ plane.z * directions.z < 0", "+ plane.z * directions.z > 0",
    ),
    Fault(
        "upper-elements-lost", "of each square of a triangle's raster the lower half answers for both",
        "reference/transport/hits.py", "dr.select(upper, mi.UInt32(1), mi.UInt32(0))", "mi.UInt32(0)",
    ),
    Fault(
        "uniform-instead-of-cosine", "patches send rays uniformly over the hemisphere, not by the cosine",
        "reference/transport/receivers.py",
        "        local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(u(0), u(1)))\n        return origin,",
        "        local = mi.warp.square_to_uniform_hemisphere(mi.Point2f(u(0), u(1)))\n        return origin,",
    ),
    Fault(
        "points-beside-triangles", "points on triangles are not folded back into them: rays start from parallelograms",
        "reference/transport/receivers.py", "a, b = dr.select(fold, 1.0 - a, a), dr.select(fold, 1.0 - b, b)", "a, b = dr.select(fold, a, a), dr.select(fold, b, b)",
    ),
    Fault(
        "first-entry-lost", "the first entry of every row is not summed",
        "reference/transport/gather.py", "state = (mi.UInt32(rows.begin),", "state = (mi.UInt32(rows.begin) + 1,",
    ),
    Fault(
        "probe-weight-with-pi", "probes' rows miss the division by π that turns radiosity into radiance",
        "reference/transport/receivers.py", "    weight: float = 4.0", "    weight: float = 4.0 * 3.14159265",
    ),
    Fault(
        "probe-axes-swapped", "y and z of the probes' spherical harmonics are swapped where rows are summed",
        "reference/transport/accumulate.py", "first = [mi.Float(Y0), Y1 * y, Y1 * z, Y1 * x]", "first = [mi.Float(Y0), Y1 * z, Y1 * y, Y1 * x]",
    ),
    Fault(
        "coefficients-reversed", "spherical-harmonics coefficients are gathered in reverse order",
        "reference/transport/gather.py", "dr.gather(mi.Float, rows.values, i * k + n)", "dr.gather(mi.Float, rows.values, i * k + (k - 1 - n))",
    ),
    Fault(
        "basis-constant", "the constant of the linear band's basis is that of the zeroth",
        "reference/sh.py", "Y1 = 0.5 * math.sqrt(3.0 / math.pi)", "Y1 = 0.5 * math.sqrt(1.0 / math.pi)",
    ),
    Fault(
        "probe-x-mirrored", "x of the probes' spherical harmonics has the wrong sign",
        "reference/transport/accumulate.py", "first = [mi.Float(Y0), Y1 * y, Y1 * z, Y1 * x]", "first = [mi.Float(Y0), Y1 * y, Y1 * z, -Y1 * x]",
    ),
    Fault(
        "lamp-tag-ignored", "area lights tagged engine light patches as radiosity input, too: their light counts twice",
        "reference/transport/patches.py", "np.where(engine, 0.0, emission)", "np.where(engine, emission, emission)", LAMPS,
    ),
    Fault(
        "engine-lamps-lost", "no direct light comes from area lights tagged engine",
        "reference/transport/patch_light.py", "if mesh.engine_lit and mesh.static and mesh.emission.any():", "if False:", LAMPS,
    ),
    Fault(
        "input-lamps-counted-twice", "emitters tagged input give direct light as if they were tagged engine",
        "reference/transport/patch_light.py", "if mesh.engine_lit and mesh.static and mesh.emission.any():",
        "if mesh.static and mesh.emission.any():", ("sphere", "corridor"),
    ),
    Fault(
        "no-shadows", "point lights and lamps shine through walls",
        "reference/transport/direct.py", "    return ~np.array(occluded(g, to_box(g, points, normals), vectors(towards), reach.astype(np.float32)))", "    return np.ones(len(points), dtype=np.bool_)", LAMPS,
    ),
    Fault(
        "lamp-without-its-cosine", "the lamp's own cosine is missing in direct light",
        "reference/transport/direct.py", "kernel = cos_here * cos_lamp *", "kernel = cos_here * (cos_lamp > 0.0) *", ("cornell",
        "two-rooms"),
    ),
    Fault(
        "point-light-falls-with-distance", "point lights fall off with the distance, not with its square",
        "reference/transport/direct.py", "strength = 1.0 / distance**2", "strength = 1.0 / distance", ("two-rooms",),
    ),
    Fault(
        "receiver-cosine-lost", "light of point lights and suns arrives without the receiver's cosine",
        "reference/transport/direct.py", "return np.asarray(strength * cosine * lit)", "return np.asarray(strength * lit)",
        ("two-rooms", "house"),
    ),
    Fault(
        "truth-without-pi", "the path tracer's estimate misses its π",
        "reference/truth/path_traced.py", "weight = cosine_direction, mi.Float(dr.pi)", "weight = cosine_direction, mi.Float(1.0)",
    ),
    Fault(
        "truth-sees-lamps", "the reference counts direct light of lamps tagged engine as indirect",
        "reference/truth/path_traced.py", "return radiance - dr.select(engine, emitted, 0.0)", "return radiance", LAMPS,
    ),
    Fault(
        "truth-one-bounce", "the reference's paths end after two bounces",
        "reference/truth/path_traced.py", '"max_depth": depth,', '"max_depth": 3,',
    ),
    Fault(
        "truth-other-albedo", "the reference's plain meshes all have the first one's albedo",
        "reference/truth/mitsuba_scene.py", "for m in meshes])[owner]\n", "for m in meshes])[0 * owner]\n", ("cornell", "two-rooms",
        "corridor"),
    ),
    Fault(
        "truth-scaled-lamps", "point lights of the reference keep their strength when the scene is scaled",
        "reference/truth/mitsuba_scene.py", "np.array(light.intensity) / scale**2", "np.array(light.intensity) / scale", ("two-rooms",),
    ),
    Fault(
        "radiosity-scaled", "patches pass on too much light by a share", "reference/transport/radiosity.py",
        "light=np.concatenate([b, seen_sky", "light=np.concatenate([b * (1.0 + SIZE), seen_sky", ENERGY, sizes=PERCENT,
    ),
    Fault(
        "exitance-scaled", "emitters shine too bright by a share", "reference/transport/patches.py",
        "emission = np.pi * np.stack(", "emission = (1.0 + SIZE) * np.pi * np.stack(", ("sphere", "corridor"), sizes=PERCENT,
    ),
    Fault(
        "albedo-scaled", "surfaces reflect too much by a share", "reference/transport/patches.py",
        "albedo = mean(_element_albedo(scene, g, cuts, e.first, triangle))",
        "albedo = (1.0 + SIZE) * mean(_element_albedo(scene, g, cuts, e.first, triangle))", ENERGY, sizes=PERCENT,
    ),
    Fault(
        "direct-scaled", "lamps give too much direct light by a share", "reference/transport/direct.py",
        "    return np.asarray(kernel * seen)", "    return np.asarray((1.0 + SIZE) * kernel * seen)", ("cornell", "two-rooms"),
        sizes=PERCENT,
    ),
    Fault(
        "probe-light-scaled", "probes gather too much light by a share", "reference/transport/receivers.py",
        "    weight: float = 4.0", "    weight: float = 4.0 * (1.0 + SIZE)", ENERGY, sizes=PERCENT,
    ),
    Fault(
        "truth-scaled", "the reference is too bright by a share", "reference/truth/path_traced.py",
        "weight = cosine_direction, mi.Float(dr.pi)", "weight = cosine_direction, mi.Float(dr.pi * (1.0 + SIZE))", ENERGY, sizes=PERCENT,
    ),
)  # fmt: skip
