"""The mutants of C sources: what is changed, one small change a mutant."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from mutation.syntax import Node, Texts

ARITHMETIC = {"+": ["-"], "-": ["+"], "*": ["/"], "/": ["*"], "%": ["*"]}
RELATIONAL = {
    "<": ["<=", ">="],
    "<=": ["<", ">"],
    ">": [">=", "<="],
    ">=": [">", "<"],
    "==": ["!="],
    "!=": ["=="],
}
LOGICAL = {"&&": ["||"], "||": ["&&"]}
BITWISE = {"&": ["|"], "|": ["&"], "^": ["&"], "<<": [">>"], ">>": ["<<"]}
NAMES = {"arithmetic": ARITHMETIC, "relational": RELATIONAL, "logical": LOGICAL, "bitwise": BITWISE}
BRACKETS = {"logical", "bitwise"}  # the new operator may bind otherwise than the old one

TRANSPARENT = {"ImplicitCastExpr", "ParenExpr", "ConstantExpr"}
CONDITIONS = {"IfStmt": 0, "WhileStmt": 0, "ConditionalOperator": 0, "DoStmt": 1, "ForStmt": 2}
BODIES = {"CompoundStmt", "CaseStmt", "DefaultStmt"}
INTEGER = re.compile(r"(0[xX][0-9a-fA-F]+|\d+)([uUlL]*)")


class Mutant(NamedTuple):
    """The bytes [start, end) of a file replaced."""

    file: str
    function: str
    start: int
    end: int
    text: str
    operator: str
    is_statement: bool = False  # what is replaced has no value
    is_constant: bool = False  # what is replaced must be known to the compiler


def bare(node: Node) -> Node:
    """Return what stands behind casts that are not written, and brackets."""
    while node.kind in TRANSPARENT and len(node.children) == 1:
        node = node.children[0]
    return node


def is_number(node: Node) -> bool:
    """Whether this is a literal, or a name for one."""
    node = bare(node)
    return node.kind in {"IntegerLiteral", "FloatingLiteral"} or (
        node.kind == "DeclRefExpr" and node.words.get("referencedDecl", {}).get("kind") == "EnumConstantDecl"
    )


def is_float(node: Node) -> bool:
    """Whether this is a floating number."""
    return node.type in {"float", "double"}


def is_scalar(node: Node) -> bool:
    """Whether this is a number."""
    return (
        re.fullmatch(r"(unsigned |signed )*(char|short|int|long|long long|_Bool|bool|float|double)|enum .*", node.type)
        is not None
    )


class Place(NamedTuple):
    """What is around a node: function, next nodes outwards, and whether the compiler must know its value."""

    function: str
    parents: tuple[Node, ...]
    is_constant: bool

    @property
    def parent(self) -> Node | None:
        """The next node outwards that is neither a cast nor a bracket."""
        return next((node for node in reversed(self.parents) if node.kind not in TRANSPARENT), None)


class Mutator:
    """The mutants of one syntax tree in some files."""

    def __init__(self, files: set[str], texts: Texts) -> None:
        self._files = files
        self._texts = texts

    def mutants(self, root: Node) -> Iterator[Mutant]:
        """Yield every mutant; those of headers and macros may come twice."""
        for declaration in root.children:
            yield from self._visit(declaration, Place("", (), is_constant=False))

    def _visit(self, node: Node, place: Place) -> Iterator[Mutant]:
        if node.kind == "FunctionDecl":
            place = Place(node.words["name"], (), is_constant=False)
        elif node.kind == "VarDecl":
            fixed = not place.function or node.words.get("storageClass") == "static"
            place = Place(place.function or node.words["name"], (), place.is_constant or fixed)
        elif node.kind in {"ConstantExpr", "EnumDecl", "RecordDecl", "StaticAssertDecl", "UnaryExprOrTypeTraitExpr"}:
            return
        if node.file in self._files:
            yield from self._changes(node, place)
        inside = Place(place.function, (*place.parents, node), place.is_constant)
        for child in node.children:
            yield from self._visit(child, inside)

    def _text(self, node: Node) -> str:
        return self._texts[str(node.file)][node.start : node.end].decode()

    def _made(self, node: Node, place: Place, operator: str, text: str, *, is_statement: bool = False) -> Mutant:
        assert node.file is not None
        return Mutant(node.file, place.function, node.start, node.end, text, operator, is_statement, place.is_constant)

    def _changes(self, node: Node, place: Place) -> Iterator[Mutant]:
        if node.kind in {"BinaryOperator", "CompoundAssignOperator"}:
            yield from self._binary(node, place)
        elif node.kind == "UnaryOperator":
            yield from self._unary(node, place)
        elif is_number(node) and node.kind not in TRANSPARENT:
            yield from self._number(node, place)
        elif node.kind == "ReturnStmt" and node.children:
            yield from self._returned(node.children[0], place)
        elif node.kind == "ArraySubscriptExpr":
            yield from self._index(node.children[1], place)
        if node.kind in CONDITIONS:
            yield from self._condition(node, place)
        if node.kind in BODIES:
            yield from self._dropped(node, place)

    def _binary(self, node: Node, place: Place) -> Iterator[Mutant]:
        left, right = node.children
        if node.of_macro or left.file != right.file or left.end > right.start or "*" in left.type:
            return
        between = self._texts[str(node.file)][left.end : right.start].decode()
        if between.strip() != node.opcode:
            return
        sign = node.opcode.removesuffix("=") if node.kind == "CompoundAssignOperator" else node.opcode
        for name, table in NAMES.items():
            for other in table.get(sign, []):
                new = between.replace(sign, other)
                text = f"{self._text(left)}{new}{self._text(right)}"
                yield self._made(node, place, name, f"({text})" if name in BRACKETS else text)
        if node.opcode in {"*", "/"} and is_float(node) and not self._sign_is_taken(node, place):
            yield self._made(node, place, "sign", f"-({self._text(node)})")

    @staticmethod
    def _sign_is_taken(node: Node, place: Place) -> bool:
        """Whether another mutant turns the sign: an outer product's, a sum's, a sign's or a return's."""
        outer = place.parent
        if outer is None:
            return False
        in_sum = outer.kind == "BinaryOperator" and outer.opcode in {"+", "-"} and bare(outer.children[1]) is node
        in_product = outer.kind == "BinaryOperator" and outer.opcode in {"*", "/"}
        return in_sum or in_product or outer.kind in {"UnaryOperator", "ReturnStmt"}

    def _unary(self, node: Node, place: Place) -> Iterator[Mutant]:
        operand = node.children[0]
        if node.of_macro or operand.file != node.file:
            return
        if node.opcode in {"-", "~", "!"}:
            yield self._made(node, place, "sign" if node.opcode == "-" else "negation", self._text(operand))
        elif node.opcode in {"++", "--"}:
            other = {"++": "--", "--": "++"}[node.opcode]
            yield self._made(node, place, "arithmetic", self._text(node).replace(node.opcode, other))

    def _number(self, node: Node, place: Place) -> Iterator[Mutant]:
        written = self._text(node)
        if node.of_macro and written.endswith(")"):
            return
        outer = place.parent
        signed = outer is not None and outer.kind == "UnaryOperator" and outer.opcode == "-"
        for text in self._other_numbers(node, written):
            if not (signed and text == f"-{written}"):
                yield self._made(node, place, "constant", f"({text})" if text.startswith("-") else text)

    @staticmethod
    def _other_numbers(node: Node, written: str) -> list[str]:
        if node.kind == "FloatingLiteral":
            value = float(node.words["value"])
            if value == 0.0:
                return [f"1.0{written.lstrip('0.')}"]
            return [f"(2 * {written})", f"-{written}"]
        if written in {"true", "false"}:
            return ["false" if written == "true" else "true"]
        literal = INTEGER.fullmatch(written)
        if literal is None:
            return [f"({written} + 1)", f"({written} - 1)"]
        value = int(literal[1], 0)
        show = hex if literal[1].lower().startswith("0x") else str
        values = [1] if value == 0 else [value - 1, value + 1]
        return [f"{show(other)}{literal[2]}" for other in values]

    def _returned(self, value: Node, place: Place) -> Iterator[Mutant]:
        if value.file is None or is_number(value):
            return
        written = self._text(value)
        if value.type in {"_Bool", "bool"}:
            texts = [f"!({written})"]
        elif is_float(value):
            texts = ["0.0f", f"-({written})"]
        elif is_scalar(value):
            texts = ["0", f"({written}) + 1"]
        elif "*" in value.type:
            texts = ["(void *)0"]
        else:
            texts = [f"({value.spelled_type}){{0}}"]
        for text in texts:
            yield self._made(value, place, "return", text)

    def _index(self, index: Node, place: Place) -> Iterator[Mutant]:
        if index.file is None or is_number(index):
            return
        for step in (" + 1", " - 1"):
            yield self._made(index, place, "index", f"({self._text(index)}){step}")

    def _condition(self, node: Node, place: Place) -> Iterator[Mutant]:
        at = CONDITIONS[node.kind]
        if at >= len(node.children):
            return
        condition = node.children[at]
        inner = bare(condition)
        negated_already = inner.opcode in {*RELATIONAL, "!"}
        if condition.file is not None and not negated_already and not is_number(condition):
            yield self._made(condition, place, "negation", f"!({self._text(condition)})")

    def _dropped(self, node: Node, place: Place) -> Iterator[Mutant]:
        """Leave out assignments and calls whose value nobody looks at."""
        for child in node.children:
            call = bare(child)
            if call.kind == "CStyleCastExpr" and call.type == "void":
                call = bare(call.children[0])
            assigns = call.opcode == "=" or call.kind == "CompoundAssignOperator" or call.opcode in {"++", "--"}
            if child.file is not None and (assigns or call.kind == "CallExpr"):
                yield self._made(child, place, "dropped", "(void)0", is_statement=True)


def unique(mutants: Iterator[Mutant]) -> list[Mutant]:
    """Return the mutants without repetitions, in the order of the text."""
    seen = {(m.file, m.start, m.end, m.text): m for m in mutants}
    return sorted(seen.values(), key=lambda m: (m.file, m.start, -m.end, m.text))
