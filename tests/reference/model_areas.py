#!/usr/bin/env python3
"""Areas of models' orthogonal projections along the vertical, computed independently of penumbra.

Reads OBJ and glTF 2.0 by their specifications in double precision and prints one line per file:
the areas [cm2] that `penumbra shadow FILE --technique simple` must give along the vertical and
along an oblique direction, or why the file is malformed or has no triangles. The areas in
tests/data/public_models.csv are made with it:

    /usr/bin/python3 tests/reference/model_areas.py /usr/share/assimp/models

Needs Debian's python3-numpy and python3-shapely. The tests read only the table.
"""

import base64
import json
import pathlib
import struct
import sys
import urllib.parse

import numpy as np
import shapely.geometry
import shapely.ops


class Refusal(Exception):
    """The file has no area; the message gives the reason."""


def require(condition, why):
    if not condition:
        raise Refusal(why)


# --- union of projected faces -----------------------------------------------------------------


def even_odd(ring):
    """The region that a closed polygon encloses by the even-odd rule."""
    outline = shapely.geometry.LineString(list(ring) + [ring[0]])
    cells = list(shapely.ops.polygonize(shapely.ops.unary_union(outline)))
    inside = [cell for cell in cells if crossings(ring, cell.representative_point()) % 2 == 1]
    return shapely.ops.unary_union(inside)


def crossings(ring, point):
    """Number of crossings of the ring by a ray from the point to the right."""
    count = 0
    for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0)):
        if (ay > point.y) != (by > point.y):
            count += point.x < ax + (point.y - ay) / (by - ay) * (bx - ax)
    return count


def signed_area(ring):
    ring = ring - ring[0]
    following = np.roll(ring, -1, axis=0)
    return 0.5 * np.sum(ring[:, 0] * following[:, 1] - ring[:, 1] * following[:, 0])


# Projection directions: the vertical, and a direction in which no face is seen edge-on.
DIRECTIONS = ((0.0, 0.0, 1.0), (0.6, 0.48, 0.64))


def measures(faces):
    """Areas [cm2] along DIRECTIONS of the union of faces, each an array of corners, z up; and the
    largest edge of their bounding box [m]."""
    if not faces:
        return [0.0, 0.0, 0.0]
    corners = np.vstack(faces)
    areas = []
    for direction in DIRECTIONS:
        across = np.linalg.svd([direction])[2][1:].T  # two unit vectors
        areas.append(1e4 * projected_area([face @ across for face in faces]))
    return [*areas, np.ptp(corners, axis=0).max()]


def projected_area(faces):
    """Area [m2] of the union of faces; each is an array of corners (u, v)."""
    middle = np.mean(np.vstack(faces), axis=0)
    regions = []
    for face in faces:
        ring = face - middle
        if len(ring) == 3:
            if signed_area(ring) != 0.0:
                regions.append(shapely.geometry.Polygon(ring))
            continue
        if np.ptp(ring, axis=0).min() == 0.0:
            continue  # seen edge-on
        polygon = shapely.geometry.Polygon(ring)
        regions.append(polygon if polygon.is_valid else even_odd(ring))
    return shapely.ops.unary_union(regions).area


# --- OBJ --------------------------------------------------------------------------------------


def obj_lines(text):
    """Numbered lines without comments; a backslash at the end continues a line."""
    held, first = "", 1
    for number, line in enumerate(text.splitlines(), 1):
        if not held:
            first = number
        line = line.split("#", 1)[0].rstrip()
        if line.endswith("\\"):
            held += line[:-1] + " "
            continue
        yield first, (held + line).split()
        held = ""


def obj_number(word, line):
    try:
        value = float(word)
    except ValueError:
        raise Refusal(f"line {line}: {word}: is not a number") from None
    require(np.isfinite(value), f"line {line}: {word}: is not finite")
    return value


def obj_measures(path):
    data = path.read_bytes()
    require(not data.startswith((b"\xff\xfe", b"\xfe\xff")), "is UTF-16")
    if data.startswith(b"\xef\xbb\xbf"):
        data = data[3:]
    positions, faces = [], []
    for line, words in obj_lines(data.decode("latin-1")):
        if not words:
            continue
        if words[0] == "v":
            require(len(words) >= 4, f"line {line}: a vertex has three coordinates")
            positions.append([obj_number(word, line) for word in words[1:4]])
        elif words[0] == "f":
            if len(words) < 4:
                continue  # fewer than three corners have no area
            face = []
            for word in words[1:]:
                index = int(word.split("/")[0])
                require(index != 0, f"line {line}: 0 is no vertex")
                face.append(index - 1 if index > 0 else len(positions) + index)
            faces.append((line, face))
    for line, face in faces:
        for index in face:
            require(0 <= index < len(positions), f"line {line}: no vertex {index + 1}")
    require(faces, "no triangles")
    positions = np.array(positions)
    return measures([positions[face] for _, face in faces])


# --- glTF 2.0 ---------------------------------------------------------------------------------

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# Extensions that compress the geometry.
COMPRESSION = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")


def element(items, index, what):
    require(isinstance(items, list), f"{what}s are no array")
    require(isinstance(index, int) and 0 <= index < len(items), f"no {what} {index}")
    require(isinstance(items[index], dict), f"{what} {index} is no object")
    return items[index]


class Gltf:
    def __init__(self, path):
        self.folder = path.parent
        data = path.read_bytes()
        self.chunk = None
        if data[:4] == b"glTF":
            version = struct.unpack_from("<I", data, 4)[0]
            require(version == 2, f"glTF {version}")
            at, chunks = 12, []
            while at + 8 <= len(data):
                size, kind = struct.unpack_from("<I4s", data, at)
                chunks.append((kind, data[at + 8:at + 8 + size]))
                at += 8 + size
            require(chunks and chunks[0][0] == b"JSON", "no JSON chunk")
            self.chunk = next((body for kind, body in chunks[1:] if kind == b"BIN\0"), None)
            data = chunks[0][1]
        if data.startswith(b"\xef\xbb\xbf"):
            data = data[3:]
        try:
            self.json = json.loads(data)
        except ValueError as error:
            raise Refusal(f"no JSON: {error}") from None
        asset = self.json.get("asset", {})
        version = asset.get("version") if isinstance(asset, dict) else None
        require(isinstance(version, str) and version.startswith("2."), f"glTF {version}")
        for name in self.json.get("extensionsRequired", []):
            require(name not in COMPRESSION, f"compressed: {name}")
        self.buffers = {}

    def list_of(self, name):
        items = self.json.get(name, [])
        require(isinstance(items, list), f"{name} is no array")
        return items

    def buffer(self, index):
        if index not in self.buffers:
            buffer = element(self.list_of("buffers"), index, "buffer")
            uri = buffer.get("uri")
            if uri is None:
                require(index == 0 and self.chunk is not None, f"buffer {index} has no bytes")
                self.buffers[index] = self.chunk
            elif uri.startswith("data:"):
                head, body = uri.split(",", 1)
                body = urllib.parse.unquote_to_bytes(body)
                self.buffers[index] = (base64.b64decode(body + b"=" * (-len(body) % 4))
                                       if head.endswith(";base64") else body)
            else:
                file = self.folder / urllib.parse.unquote(uri)
                require(file.is_file(), f"no file {uri}")
                self.buffers[index] = file.read_bytes()
            require(len(self.buffers[index]) >= buffer["byteLength"],
                    f"buffer {index} has fewer bytes than it says")
        return self.buffers[index]

    def stretch(self, view, offset, count, component, width):
        """count x width numbers of a buffer view."""
        v = element(self.list_of("bufferViews"), view, "bufferView")
        dtype = np.dtype(COMPONENTS[component])
        size = dtype.itemsize * width
        stride = v.get("byteStride", size)
        begin = v.get("byteOffset", 0)
        need = offset + (stride * (count - 1) + size if count else 0)
        require(need <= v["byteLength"], f"bufferView {view}: {need} bytes are needed")
        data = self.buffer(v["buffer"])
        require(begin + v["byteLength"] <= len(data), f"bufferView {view} leaves its buffer")
        return np.ndarray((count, width), dtype, data, begin + offset,
                          (stride, dtype.itemsize)).copy()

    def accessor(self, index):
        """Numbers of an accessor in double precision; normalised ones between -1 and 1."""
        a = element(self.list_of("accessors"), index, "accessor")
        count, width = a["count"], WIDTHS[a["type"]]
        component = a["componentType"]
        values = np.zeros((count, width), np.dtype(COMPONENTS[component]))
        if "bufferView" in a:
            values = self.stretch(a["bufferView"], a.get("byteOffset", 0), count, component, width)
        if "sparse" in a:
            s = a["sparse"]
            at = self.stretch(s["indices"]["bufferView"], s["indices"].get("byteOffset", 0),
                              s["count"], s["indices"]["componentType"], 1)[:, 0]
            require(np.all(at < count), f"accessor {index}: a sparse index leaves it")
            values[at] = self.stretch(s["values"]["bufferView"], s["values"].get("byteOffset", 0),
                                      s["count"], component, width)
        if component != 5126 and a.get("normalized", False):
            largest = np.iinfo(values.dtype).max
            return np.maximum(values.astype(float) / largest, -1.0)
        return values.astype(float)


def local_matrix(node):
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    return trs(node.get("translation", (0, 0, 0)), node.get("rotation", (0, 0, 0, 1)),
               node.get("scale", (1, 1, 1)))


def trs(translation, rotation, scale):
    x, y, z, w = np.array(rotation, float) / np.linalg.norm(rotation)
    turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array(scale, float)
    matrix[:3, 3] = translation
    return matrix


def placed_nodes(gltf):
    """Node index -> (world matrix, visible), of the scene's nodes."""
    nodes = gltf.list_of("nodes")
    scenes = gltf.list_of("scenes")
    if scenes:
        roots = element(scenes, gltf.json.get("scene", 0), "scene").get("nodes", [])
    else:
        children = {c for node in nodes for c in node.get("children", [])}
        roots = [i for i in range(len(nodes)) if i not in children]
    placed = {}
    waiting = [(root, np.eye(4), True, ()) for root in roots]
    while waiting:
        index, parent, visible, above = waiting.pop()
        require(index not in above, f"node {index} is below itself")
        require(index not in placed, f"node {index} has two parents")
        node = element(nodes, index, "node")
        world = parent @ local_matrix(node)
        extension = node.get("extensions", {}).get("KHR_node_visibility", {})
        visible = visible and extension.get("visible", True)
        placed[index] = (world, visible)
        waiting += [(child, world, visible, above + (index,)) for child in node.get("children", [])]
    return placed


def triangles_of(mode, indices):
    if mode == 4:  # a rest of fewer than three corners draws nothing
        return indices[:len(indices) // 3 * 3].reshape(-1, 3)
    if len(indices) < 3:
        return np.zeros((0, 3), int)
    if mode == 5:
        return np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    return np.stack([np.full(len(indices) - 2, indices[0]), indices[1:-1], indices[2:]], axis=1)


def is_invisible(gltf, primitive):
    """Tests the alpha of the base colour factor; textures are not read."""
    if "material" not in primitive:
        return False
    material = element(gltf.list_of("materials"), primitive["material"], "material")
    base = material.get("pbrMetallicRoughness", {})
    alpha = base.get("baseColorFactor", [1, 1, 1, 1])[3] if isinstance(base, dict) else 1
    mode = material.get("alphaMode", "OPAQUE")
    return (mode == "BLEND" and alpha <= 0) or (
        mode == "MASK" and alpha < material.get("alphaCutoff", 0.5))


def require_uncompressed(gltf, primitive):
    """Rejects geometry that only a compression extension contains, even if it is not required."""
    position = element(gltf.list_of("accessors"), primitive["attributes"]["POSITION"], "accessor")
    for name in COMPRESSION:
        require(name not in primitive.get("extensions", {}) or "bufferView" in position,
                f"compressed: {name}")


def weighted_targets(gltf, node, mesh, primitive):
    positions = gltf.accessor(primitive["attributes"]["POSITION"])
    weights = node.get("weights", mesh.get("weights", []))
    for weight, target in zip(weights, primitive.get("targets", [])):
        if "POSITION" in target:
            shift = gltf.accessor(target["POSITION"])
            require(len(shift) == len(positions), "a morph target has another vertex count")
            positions = positions + weight * shift
    return positions


def joint_matrices(gltf, skin, placed):
    joints = skin["joints"]
    inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in skin:
        listed = gltf.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4)
        require(len(listed) >= len(joints), "there are fewer inverse bind matrices than joints")
        inverse = listed[:len(joints)].transpose(0, 2, 1)
    for joint in joints:
        require(joint in placed, f"joint {joint} is no node of the scene")
    return np.array([placed[joint][0] for joint in joints]) @ inverse


def skinned(gltf, primitive, positions, matrices):
    """glTF 2.0, 3.7.3.3: the mesh follows its joints, not its node."""
    blended = np.zeros((len(positions), 4, 4))
    attributes = primitive["attributes"]
    for group in range(8):
        if f"JOINTS_{group}" not in attributes:
            break
        joints = gltf.accessor(attributes[f"JOINTS_{group}"]).astype(int)
        weights = gltf.accessor(attributes[f"WEIGHTS_{group}"])
        for corner in range(4):
            used = weights[:, corner] != 0
            require(np.all(joints[used, corner] < len(matrices)), "a joint is not of the skin")
            picked = matrices[np.where(used, joints[:, corner], 0)]
            blended += weights[:, corner, None, None] * picked
    return np.einsum("nij,nj->ni", blended[:, :3], homogeneous(positions))


def homogeneous(positions):
    return np.hstack([positions, np.ones((len(positions), 1))])


def instance_matrices(gltf, node):
    extension = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
    if extension is None:
        return [np.eye(4)]
    listed = {name: gltf.accessor(index) for name, index in extension["attributes"].items()}
    count = min(len(values) for values in listed.values())
    at = lambda name, i, default: listed[name][i] if name in listed else default
    return [trs(at("TRANSLATION", i, (0, 0, 0)), at("ROTATION", i, (0, 0, 0, 1)),
                at("SCALE", i, (1, 1, 1))) for i in range(count)]


def gltf_measures(path):
    gltf = Gltf(path)
    placed = placed_nodes(gltf)
    faces, triangle_count = [], 0
    for index, (world, visible) in placed.items():
        node = gltf.list_of("nodes")[index]
        if "mesh" not in node:
            continue
        mesh = element(gltf.list_of("meshes"), node["mesh"], "mesh")
        require(isinstance(mesh.get("primitives"), list), "primitives are no array")
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", 4)
            if mode < 4 or "POSITION" not in primitive["attributes"]:
                continue
            require_uncompressed(gltf, primitive)
            positions = weighted_targets(gltf, node, mesh, primitive)
            require(np.all(np.isfinite(positions)), "a position is not finite")
            indices = (gltf.accessor(primitive["indices"])[:, 0].astype(int)
                       if "indices" in primitive else np.arange(len(positions)))
            require(np.all(indices < len(positions)), "an index has no vertex")
            triangles = triangles_of(mode, indices)
            triangle_count += len(triangles)
            if not visible or is_invisible(gltf, primitive):
                continue
            if "skin" in node:
                skin = element(gltf.list_of("skins"), node["skin"], "skin")
                places = [skinned(gltf, primitive, positions, joint_matrices(gltf, skin, placed))]
            else:
                places = [(homogeneous(positions) @ (world @ instance).T)[:, :3]
                          for instance in instance_matrices(gltf, node)]
            for place in places:
                up = np.stack([place[:, 0], -place[:, 2], place[:, 1]], axis=1)  # from y up to z up
                faces += list(up[triangles])
    require(triangle_count, "no triangles")
    return measures(faces)


# --- command line -----------------------------------------------------------------------------


def main(arguments):
    for argument in arguments:
        top = pathlib.Path(argument)
        files = sorted(f for f in top.rglob("*") if f.is_file()) if top.is_dir() else [top]
        for file in files:
            reader = {".obj": obj_measures, ".gltf": gltf_measures, ".glb": gltf_measures}.get(
                file.suffix.lower())
            if reader is None:
                continue
            name = file.relative_to(top) if top.is_dir() else file
            try:
                print(f"{name},{','.join(f'{number:.9g}' for number in reader(file))},", flush=True)
            except Refusal as refusal:
                print(f"{name},,,,{refusal}", flush=True)
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                print(f"{name},,,,malformed: {error!r}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
