"""A trial: random files and random options, as data that can be run again with less of it."""

import os
import re

import meshes
import options

# Options that a trial sets itself, and those that do something else than a bake or a grid.
OWN = {
    "bisque-bake": "output device part merge list memory threads help version",
    "bisque-voxelize": "output tris parse-only info verify memory threads help version",
    "bisque-simplify": "output memory threads help version",
    "bisque-compare": "memory threads help version",
}
# Options that must not change a byte.
IDLE = {"progress", "json", "tmpdir", "gpu-memory"}
SHARE = 0.15  # of the options that are given
SIZES = {"size", "resolution", "voxel-size"}  # without one, a trial takes long
NEEDED = SIZES | {"triangles", "error"}
EACH = {"scale", "up", "translate"}  # may be given for each file of a scan
ODD = "\nforged line\x1b[2K"  # in some names of files
FORGED = "(?m)^forged line"
TEMPORARY = "temporary"  # directory of --tmpdir, beside the inputs
UNKNOWN = set()  # options with a syntax of their own that no function here draws


class Scan:
    def __init__(self, name, files, given, kind):
        self.name, self.files, self.given, self.kind = name, files, given, kind

    @property
    def path(self):
        return "../in/%s.%s" % (self.name, self.kind)


class Trial:
    """The inputs of a bake, in `inputs`, and its options: a list of (option, value) for each command."""

    def __init__(self, random, inputs, tables):
        self.random, self.inputs, self.tables = random, inputs, tables
        self.large = random.random() < 0.1  # tiles are cut into bands and blocks
        self.shape = meshes.Shape(random)
        self.tiles = random.choice([[0], [0], [0, 1], [0, 11]])
        self.object_count = random.choice([1, 1, 1, 2])
        self.odd = ODD if self.object_count == 1 and random.random() < 0.1 else ""
        self.has_uvs, self.has_colors = random.random() < 0.6, random.random() < 0.6
        self.write_images()
        self.scans = self.make_scans()
        self.lows = self.make_lows()
        self.bake = self.draw("bisque-bake")
        self.compare = self.draw("bisque-compare")
        self.simplify = self.draw("bisque-simplify")
        self.name = self.draw_name()

    # ---- files ----

    def write_images(self):
        side = self.random.choice([1, 7, 32])
        self.image = self.random.choice([".png"] * 9 + [".ppm"])  # of the others, a process reads each
        for name, channels in (("grey", 1), ("color", 3), ("rough", 1)):
            texels = bytes(self.random.randint(0, 255) for _ in range(channels * side * side))
            meshes.write_image(os.path.join(self.inputs, name + self.image), side, channels, texels)
        with open(os.path.join(self.inputs, "scan.mtl"), "w") as out:
            out.write("newmtl clay\nKd 0.8 0.3 0.2\nmap_Pr rough%s\nnewmtl glaze\nKd 0.1 0.5 0.9\n" % self.image)
            out.write("map_Kd color%s\n" % self.image if self.random.random() < 0.5 else "")

    def make_scans(self):
        """Writes scans, one for each object or several for all, each in some files."""
        scans = []
        for i in range(max(self.object_count, self.random.choice([1, 1, 1, 2]))):
            name = "o%d_high" % i
            files, count = [], self.random.choice([1, 1, 2])
            normals, large = self.random.random() < 0.3, self.large and i == 0 and self.random.random() < 0.3
            for part in range(count):
                mesh = meshes.Mesh()
                mesh.library = "scan.mtl" if self.random.random() < 0.5 else None
                for material in ["clay", "glaze"] if mesh.library else [None]:
                    least, most = (180, 200) if large else (1, 30)  # large: several chunks
                    large = False
                    meshes.patch(mesh, self.random, self.shape, self.random.randint(least, most),
                                 self.random.randint(least, most), True, "p%d" % part, material, None, i if self.object_count > 1 else 0,
                                 self.random.random() < 0.5)
                if self.random.random() < 0.3:
                    for _, _, faces in mesh.parts:
                        self.random.shuffle(faces)
                kind = self.random.choice(["obj", "obj", "text.ply", "ply", "stl", "gltf"])
                path = os.path.join(self.inputs, "%s_%d%s.%s" % (name, part, self.odd, kind))
                meshes.write(mesh, path, kind, self.has_uvs, normals, self.has_colors)
                if self.random.random() < 0.2:
                    path = meshes.pack(path, self.random)
                files.append("../in/" + os.path.basename(path))
            given = self.draw("bisque-voxelize", count)
            kind = "nvdb" if value("no-tris", given) is not None else self.random.choice(["nvdb", "nvdb", "tris"])
            scans.append(Scan(name, files, given, kind))
        return scans

    def place(self, tile, part, count, overlaps):
        """Returns a map from the unit square to a chart in a UDIM tile."""
        low, width = (0.05, 0.9) if overlaps else (0.05 + part / count, 0.9 / count)
        return lambda u, v: (tile % 10 + low + width * u * 0.95, tile // 10 + 0.05 + 0.9 * v)

    def make_lows(self):
        """Writes low-poly meshes, of which one may have several objects; and a cage of a single one."""
        single = self.random.random() < 0.6
        normals, overlaps = self.random.random() < 0.5, self.random.random() < 0.2
        built, count = [], self.object_count * len(self.tiles)
        for i in range(self.object_count):
            mesh = built[0] if single and built else meshes.Mesh()
            for k, tile in enumerate(self.tiles):
                meshes.patch(mesh, self.random, self.shape, self.random.randint(1, 8), self.random.randint(1, 8), False,
                             "o%d_low" % i, self.random.choice(["skin", "cloth"]),
                             self.place(tile, i * len(self.tiles) + k, count, overlaps), i)
            if mesh not in built:
                built.append(mesh)
        paths = []
        for i, mesh in enumerate(built):
            kind = self.random.choice(["obj", "obj", "ply", "gltf"])
            path = os.path.join(self.inputs, "o%d_low%s.%s" % (i, self.odd, kind))
            meshes.write(mesh, path, kind, True, normals, False)
            kept = meshes.pack(path, self.random) if self.random.random() < 0.1 else path
            paths.append("../in/" + os.path.basename(kept))
            for k, n in enumerate(mesh.normals):
                mesh.points[k] = [p + 0.2 * self.shape.size * x for p, x in zip(mesh.points[k], n)]
            meshes.write(mesh, os.path.join(self.inputs, "cage.%s" % kind), kind, True, normals, False)
            self.cage = "../in/cage.%s" % kind
        return paths

    # ---- options ----

    def draw(self, program, files=1):
        """Returns random options; those that may be given for each file may occur so often."""
        given = []
        for option in self.tables[program]:
            if option.name in OWN[program].split() or self.random.random() > SHARE:
                continue
            special = getattr(self, "draw_" + option.id.replace("-", "_").replace(" ", "_"), None)
            if not special and option.kind in ("own", "list", "text"):
                UNKNOWN.add(option.id)
                continue
            for _ in range(files if option.name in EACH and self.random.random() < 0.5 else 1):
                drawn = special(program) if special else options.value_of(option, self.random)
                if drawn is not None:
                    given.append((option, drawn))
        if program == "bisque-bake" and value("size", given) is None:
            given.append((self.option(program, "size"), self.draw_size(program)))
        if program == "bisque-voxelize":
            given = self.with_one(program, given, {"resolution", "voxel-size"})
        if program == "bisque-simplify":
            given = self.with_one(program, given, {"triangles", "error"})
        return given

    def with_one(self, program, given, names):
        """Returns the options with exactly one of those that exclude each other."""
        given = [(option, drawn) for option, drawn in given if option.name not in names]
        name = self.random.choice(sorted(names))
        draw = getattr(self, "draw_" + name.replace("-", "_"))
        return given + [(self.option(program, name), draw(program))]

    def option(self, program, name):
        return next(option for option in self.tables[program] if option.name == name)

    def draw_size(self, program):
        side = self.random.randint(100, 180) if self.large else self.random.randint(1, 48)
        if self.random.random() < 0.2:
            first = "%d=%d" % (1001 + self.tiles[0], self.random.randint(1, 64))
            return first + ",*=%d" % side if len(self.tiles) > 1 else first
        return self.random.choice(["%d" % side, "%dx%d" % (side, self.random.randint(1, 64))])

    def draw_tiles(self, program):
        return "%d" % (1001 + self.random.choice(self.tiles)) if self.random.random() < 0.7 else "1001-1100"

    def draw_maps(self, program):
        names = ["normal", "mask", "height", "position", "curvature", "ao", "bent", "thickness",
                 "confidence"]
        names += ["color"] if self.has_colors else []
        if self.random.random() < 0.2:
            return "all"
        return ",".join(self.random.sample(names, self.random.randint(1, 5)))

    def draw_pack(self, program):
        names = self.random.sample(["ao", "mask", "1-mask", "height", "0", "1"], self.random.randint(1, 4))
        return "m_pack=" + ",".join(names)

    def draw_texture(self, program):
        return "../in/color" + self.image if program == "bisque-voxelize" else None

    def draw_cage(self, program):
        return self.cage if len(self.lows) == 1 else None

    def draw_skew(self, program):
        return "../in/grey" + self.image

    def draw_scan_normal_map(self, program):
        return "../in/color" + self.image if self.has_uvs else None

    def draw_reference(self, program):
        return "../in"

    def draw_match(self, program):
        return self.random.choice(["name", "_low,_high"]) if self.object_count > 1 else None

    def draw_preview(self, program):
        return "look.png" if self.random.random() < 0.3 else None  # a preview takes long

    def draw_view_count(self, program):
        return str(self.random.randint(1, 3))

    def draw_view_from(self, program):
        return "%.6g" % self.random.uniform(0, 360)

    def draw_view_above(self, program):
        return "%.6g" % self.random.uniform(0, 90)

    def length(self, program):
        return "%.6g" % (self.shape.size * 10 ** self.random.uniform(-2, 0))

    draw_front = draw_back = draw_distance_ao = draw_distance_thickness = draw_distance_curvature = length
    draw_range_height = length

    def draw_low_scale(self, program):
        return self.random.choice(["1", "1", "0.99"])

    def draw_low_turn(self, program):
        return self.random.choice(["none", "none", "none", "z-up"])

    def draw_low_x(self, program):
        return "%.6g" % (self.shape.size * self.random.uniform(0, 0.02))

    draw_low_y = draw_low_z = draw_low_x

    def draw_samples(self, program):
        return str(self.random.choice([1, 1, 2, 3] if self.large else [1, 1, 2, 3, 5]))

    def draw_resolution(self, program):
        return str(self.random.choice([1, 20, 40, 40, 40, 90, 200]))

    def draw_voxel_size(self, program):
        return "%.6g" % (self.shape.size / self.random.randint(10, 100))

    def draw_scale(self, program):
        if program == "bisque-voxelize":
            return self.random.choice(["1", "1.01", "0.5"])
        return "%.6g" % 10 ** self.random.uniform(-3, 2)

    def draw_up(self, program):
        return self.random.choice(["y", "z", None, None])  # a scan that lies apart makes a trial short

    def draw_translate(self, program):
        return ",".join("%.6g" % (self.shape.size * self.random.uniform(-0.02, 0.02)) for _ in range(3))

    def draw_origin(self, program):
        return self.draw_translate(program)

    def draw_tmpdir(self, program):
        return "../in/" + TEMPORARY

    def draw_triangles(self, program):
        counts = self.random.sample(range(4, 200), self.random.choice([1, 1, 3]))
        self.low_name = ("m_low_<N>" if len(counts) > 1 else "m_low") + self.odd + self.random.choice([".obj", ".ply", ".glb"])
        share = ["%.3g%%" % self.random.uniform(5, 90)] if self.random.random() < 0.2 else []
        return ",".join([*map(str, counts[len(share):]), *share])

    def draw_error(self, program):
        self.low_name = "m_low" + self.random.choice([".obj", ".ply", ".glb"])
        return self.random.choice([self.length(program), "%.3g%%" % self.random.uniform(0.1, 20)])

    def draw_min_component(self, program):
        return "%.3g%s" % (self.random.uniform(0, 30), self.random.choice(["", "%"]))

    def draw_channels(self, program):
        words = ["id", "roughness", "opacity", "id,roughness"] + ["metallic=../in/rough" + self.image] * self.has_uvs
        return self.random.choice(words)

    def draw_vdb(self, program):
        return "x.vdb"

    def draw_heatmap(self, program):
        return "heat.png"

    def draw_mask(self, program):
        return None

    draw_mask_a = draw_mask_b = draw_mask

    def draw_name(self):
        parts = ["m_<MAP>" + self.odd]
        if len(self.tiles) > 1 or self.random.random() < 0.2:
            parts.append(self.random.choice(["<UDIM>", "<UVTILE>"]))
        if self.random.random() < 0.2:
            parts.append(self.random.choice(["<OBJECT>", "<MATERIAL>"]))
        return ".".join(parts) + self.random.choice([".exr", ".png"])


def value(name, given):
    """Returns the value of an option by its name, "" for one without; None if it is not given."""
    return next((drawn for option, drawn in given if option.name == name), None)


def words(given, random=None):
    """Returns the words of a command line. random: in another order."""
    if random:  # values for each file keep their order
        order = sorted(given, key=lambda one: random.random())
        each = iter([one for one in given if one[0].name in EACH])
        given = [next(each) if one[0].name in EACH else one for one in order]
    out = []
    for option, drawn in given:
        if option.key:
            out += ["--" + option.name, "%s=%s" % (option.key, drawn)]
        else:
            out += ["--" + option.name] + ([drawn] if option.argument else [])
    return out


def named_in(message, given, random):
    """Returns the option that a message of wrong usage speaks of, or any if `random` is given; else None."""
    given = [(option, drawn) for option, drawn in given if option.name not in NEEDED]
    for option, drawn in given:
        if re.search(r"--%s\b" % option.name, message) or (len(drawn) > 3 and drawn in message):
            return option
    return random.choice(given)[0] if given and random else None
