"""The type stubs name what the package has, with the same parameters."""

import ast
import dataclasses
import inspect
import re
import unittest
from pathlib import Path

import penumbra

STUB = Path(penumbra.__file__).with_name("__init__.pyi")
# Methods that every class has or that only some Python versions add.
IGNORED = {"__repr__", "__hash__", "__new__"}


def stub_nodes():
    tree = ast.parse(STUB.read_text())
    kinds = (ast.ClassDef, ast.FunctionDef)
    return {node.name: node for node in tree.body if isinstance(node, kinds)}


def members_of_stub(node):
    """Names of methods and attributes -> the function, or None for an attribute."""
    members = {}
    for item in node.body:
        if isinstance(item, ast.FunctionDef):
            is_property = any(isinstance(d, ast.Name) and d.id == "property"
                              for d in item.decorator_list)
            members[item.name] = None if is_property else item
        elif isinstance(item, ast.AnnAssign):
            members[item.target.id] = None
    return members


def parameters_of_stub(function):
    """(name, keyword only, has a default) of each parameter without self."""
    arguments = function.args
    positional = arguments.posonlyargs + arguments.args
    first_default = len(positional) - len(arguments.defaults)
    found = [(a.arg, False, i >= first_default) for i, a in enumerate(positional)]
    found += [(a.arg, True, d is not None)
              for a, d in zip(arguments.kwonlyargs, arguments.kw_defaults)]
    return [entry for entry in found if entry[0] != "self"]


def parameters_of_function(function):
    """The same, of a function of the package. pybind11 writes it in the first line of the text."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        line = function.__doc__.splitlines()[0]
        call = re.fullmatch(r"\w+(\(.*\)) -> .*", line).group(1)
        text = re.sub(r"<[^<>]*>", "...", call)  # defaults that are no Python
        parsed = ast.parse(f"def f{text}: ...").body[0]
        return parameters_of_stub(parsed)
    return [(p.name, p.kind is p.KEYWORD_ONLY, p.default is not p.empty)
            for p in parameters if p.name != "self"]


def own_members(cls):
    names = {name for name in vars(cls) if not name.startswith("_")}
    special = {"__init__", "__len__", "__iter__", "__getitem__", "__eq__", "__array__"}
    names |= {name for name in vars(cls) if name in special}
    if dataclasses.is_dataclass(cls):
        names = {field.name for field in dataclasses.fields(cls)}
    return names


class Stubs(unittest.TestCase):
    def test_are_installed_with_the_package(self):
        self.assertTrue(STUB.with_name("py.typed").exists())

    def test_name_everything(self):
        self.assertEqual(set(stub_nodes()), set(penumbra.__all__))
        for name in penumbra.__all__:
            self.assertTrue(getattr(penumbra, name).__doc__, f"{name} has no text")

    def test_name_the_members_of_classes(self):
        for name, node in stub_nodes().items():
            if not isinstance(node, ast.ClassDef):
                continue
            with self.subTest(name):
                cls = getattr(penumbra, name)
                members = members_of_stub(node)
                expected = own_members(cls)
                if issubclass(cls, Exception):
                    expected = set()
                elif name == "Recording":
                    expected |= {"folder"}  # of each object
                elif "__init__" not in members:
                    with self.assertRaises(TypeError):  # only the package makes such objects
                        cls()
                    expected -= {"__init__"}
                self.assertEqual(set(members) - IGNORED, expected)
                bases = [base.id for base in node.bases]
                if bases:
                    self.assertEqual(bases, [base.__name__ for base in cls.__bases__])

    def test_name_the_parameters(self):
        checked = 0
        for name, node in stub_nodes().items():
            value = getattr(penumbra, name)
            functions = {name: (node, value)}
            if isinstance(node, ast.ClassDef):
                functions = {
                    f"{name}.{member}": (item, getattr(value, member))
                    for member, item in members_of_stub(node).items()
                    if item is not None and member not in ("__eq__", "__iter__", "__len__")
                }
            for label, (item, function) in functions.items():
                with self.subTest(label):
                    checked += 1
                    self.assertEqual(parameters_of_stub(item), parameters_of_function(function))
                    if not label.endswith("__getitem__"):
                        self.assertGreater(len(inspect.getdoc(function) or ""), 10)
        self.assertGreaterEqual(checked, 40)

    def test_describe_members(self):
        """Every property and method of a class has a text."""
        for name in penumbra.__all__:
            cls = getattr(penumbra, name)
            if not inspect.isclass(cls) or issubclass(cls, Exception):
                continue
            if dataclasses.is_dataclass(cls):
                continue  # its text describes the members
            for member in own_members(cls) - {"__eq__", "__len__", "__iter__", "__getitem__"}:
                with self.subTest(f"{name}.{member}"):
                    self.assertTrue(inspect.getdoc(vars(cls)[member]))


if __name__ == "__main__":
    unittest.main()
