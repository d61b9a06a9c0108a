"""The emitted text as a person would write it: what is Yosys' own way goes, behaviour stays.

A register's next value stands where the register is clocked, a signal has one name, a port is declared once and
says what it is for, and of identical modules there is one.
"""

import inspect
import re
import textwrap
from collections import Counter, defaultdict

from ..rtl.top import PlainPorts
from .ports import plain

_NAME = r"(?:\\\S+ |[A-Za-z_]\w*)"
_TOKEN = re.compile(rf"(?<![.\w$'\"]){_NAME}")
_DECLARATION = re.compile(rf"  (input|output|wire|reg) (\[\d+:0\] )?({_NAME})(?: = (\S+))?;")
_ALIAS = re.compile(rf"  assign ({_NAME}) = ({_NAME});")
_CLOCKED = re.compile(rf"  always @\(posedge (\w+)\)\n    ({_NAME}) <= ({_NAME});")
_TARGET = re.compile(rf"^( +)({_NAME})((?:\[[^\]]*\])?) = ", re.MULTILINE)
_ANONYMOUS = re.compile(r"\\\$\d+ |\\\$auto\$\S+ |_\d+_")
_YOSYS_START = re.compile(r"    if \((\\\$auto\$verilog_backend\S+ )\) begin end\n")

#: A register that is never written: its initial value is an event, so that simulators run the blocks that read it.
_START = "at_start"


def readable(text, top, ports, notes):
    """All modules of ``text``, as Yosys writes them and in that order, as a person would write them.

    ``ports`` are those of the module ``top``, in order: ``{name: (comment, {attribute: value})}``. ``notes`` of each
    module are lines of its comment, and what its ports are for: ``{module: ([line], {port: text})}``.
    """
    text = re.sub(r"^ *\(\* full_case = 32'd1 \*\)\n", "", text, flags=re.MULTILINE)
    text = re.sub(r":\n +/\* empty \*/;", ": ;", text)
    found = [_Module(module) for module in re.findall(r"^module .*?^endmodule$", text, re.DOTALL | re.MULTILINE)]
    renamed = {module.name: module.clean() for module in found}
    texts = {}
    for module in found:
        module.connect(renamed)
        lines, members = notes.get(module.name, ((), {}))
        described = ports if module.name == top else {
            name: (members.get(re.split(r"__|\.", name)[0], ""), {}) for name in module.ports
        }  # fmt: skip
        texts[module.name] = _comment(lines) + module.text(described)
    return "\n".join(_merged(texts, top).values())


def notes_of(fragment, name):
    """What docstrings say of each module: ``notes`` of :func:`readable`, from an elaborated design."""
    found = {}
    component = next((o for o in fragment.origins or () if type(o).__module__.startswith("cmfpga.")), None)
    if component is not None:
        found[name] = _lines(component), _members(component)
    for inner, label, _ in fragment.subfragments:
        found |= notes_of(inner, f"{name}_{label}")
    return found


def _doc(component):
    """Name and docstring of its class."""
    kind = next(kind for kind in type(component).__mro__ if not issubclass(kind, PlainPorts))
    return kind.__name__, inspect.getdoc(kind) or ""


def _lines(component):
    """A docstring's first sentence, and those that tell latency or throughput, with the component's figures."""
    name, doc = _doc(component)
    doc = re.split(r"\n(?:Parameters|Members|Attributes)\n-", re.sub(r"::\n\n(?: .*\n|\n)+", ".\n", doc))[0]
    doc = re.sub(r":attr:`(latency\w*)`", lambda m: str(getattr(component, m[1], m[1])), doc)
    first, *others = map(_unmarked, re.split(r"(?<=\.)(?<!Eqs\.)(?<!Eq\.)(?<!\d\.)\s+(?=[^a-z\d−(])", doc))
    figure = re.compile(r"latency|\b(?:per|a|every|each) cycle|throughput", re.IGNORECASE)
    found = [first, *(one for one in others if figure.search(one) and not re.search(r"\s1\. ", one))]
    latency = getattr(component, "latency", None)
    if isinstance(latency, int) and not any("atency" in line for line in found):
        found.append(f"Latency {latency} cycle{'s' * (latency != 1)}.")
    return [f"{name}: {found[0]}", *found[1:]]


def _members(component):
    """``{member: its docstring's first sentence}``."""
    section = re.search(r"^Members\n-+\n(.*?)(?=\n\n\S+\n--|\Z)", _doc(component)[1], re.DOTALL | re.MULTILINE)
    found = {}
    for names, text in re.findall(r"^(\S.*?) : .*\n((?: .*\n?)+)", section[1] if section else "", re.MULTILINE):
        sentence = re.split(r"(?<=[.;]) ", _unmarked(" ".join(text.split())))[0].rstrip(".;")
        found |= dict.fromkeys(re.split(r",\s*", names), sentence)
    return found


def _unmarked(text):
    text = re.sub(r":\w+:`[~!]?([^`]*)`", r"\1", text)
    return plain(text.replace("`", "")).encode("ascii", "replace").decode()


def _comment(lines):
    wrapped = (part for line in lines for part in textwrap.wrap(" ".join(line.split()), 116))
    return "".join(f"// {line}\n" for line in wrapped)


class _Module:
    """The parts of one module's text."""

    def __init__(self, text):
        head, _, body = text.partition(");\n")
        self.name, names = re.match(r"module (\w+) ?\((.*)", head, re.DOTALL).groups()
        self.ports = _TOKEN.findall(names)
        self.kinds, self.ranges, self.initial, self.items = {}, {}, {}, []
        for piece in re.split(r"\n(?=  [^ ])", body.removesuffix("\nendmodule")):
            if match := _DECLARATION.fullmatch(piece):
                kind, bits, name, initial = match.groups()
                self.ranges[name] = bits or ""
                self.kinds[name] = f"{self.kinds[name]} reg" if kind == "reg" and name in self.kinds else (
                    self.kinds.get(name) or kind
                )  # fmt: skip
                if initial:
                    self.initial[name] = initial
            elif self.items and (piece.startswith(("  end", "  );")) or self.items[-1].endswith("*)")):
                self.items[-1] += "\n" + piece
            elif piece.strip():
                self.items.append(piece)

    def clean(self):
        """Everything but comments, and ports of the blocks inside; returns new names of its own ports."""
        self._join_aliases()
        self._clock_next_values()
        self._start()
        self._drop_unread()
        return self._rename()

    def connect(self, renamed):
        """Use the names of ports that the blocks inside have now: ``{module: {old: new}}``."""
        for k, item in enumerate(self.items):
            if (match := re.match(r"  (\w+) +[\w\\]\S* +\(\n", item)) and match[1] in renamed:
                ports = renamed[match[1]]
                item = re.sub(r"^(  \w+) +(\S+) +\(", r"\1 \2 (", item)
                port = re.compile(rf"(?<=^    \.){_NAME}(?= ?\()", re.MULTILINE)
                self.items[k] = port.sub(lambda match, ports=ports: ports.get(match[0], match[0]), item)

    def text(self, described):
        """The module's text; ``described``: each port's comment and attributes, in order."""
        lines = [f"module {self.name}("]
        names = (
            [*described] if "clk" not in self.ports else sorted(described, key=lambda n: {"clk": 0, "rst": 1}.get(n, 2))
        )
        for name in names:
            comment, attributes = described[name]
            lines += [f'  (* {kind} = "{value}" *)' for kind, value in attributes.items()]
            comma = "," * (name != names[-1])
            lines.append(f"  {self.kinds[name]} {self.ranges[name]}{name}{comma}" + f"  // {comment}" * bool(comment))
        lines.append(");")
        fields, first = {}, re.compile(rf"  assign ({_NAME}) = (\w+\[\d+(?::\d+)?\]);")
        for item in self.items:
            if (match := first.fullmatch(item)) and "." in match[1]:
                fields[match[1]] = match[2]
        nameless = defaultdict(list)
        for name, kind in self.kinds.items():
            if re.fullmatch(r"n\d+", name) and name not in self.initial:
                nameless[f"  {kind} {self.ranges[name]}"].append(name)
            elif name not in {*self.ports, *fields}:
                lines.append(f"  {kind} {self.ranges[name]}{name};")
            # An event at time 0 that starts ``always @*``, which a declaration's value is not in SystemVerilog.
            if name in self.initial:
                lines.append(f"  initial {name} = {self.initial[name]};")
        for start, names in nameless.items():
            names = ", ".join(sorted(names, key=lambda name: int(name[1:])))
            lines.append(textwrap.fill(f"{start}{names};", 118, subsequent_indent="    "))
        lines += [f"  wire {self.ranges[name]}{name} = {value};" for name, value in fields.items()]
        items = [item for item in self.items if not ((m := first.fullmatch(item)) and m[1] in fields)]
        return "\n".join([*lines, *items, "endmodule"]) + "\n"

    def _uses(self):
        return Counter(token for item in self.items for token in _TOKEN.findall(item))

    def _substitute(self, name_of):
        self.items = [_TOKEN.sub(lambda match: name_of(match[0]), item) for item in self.items]

    def _join_aliases(self):
        """``assign a = b``, one of them without a name of its own: one signal."""
        instead, kept = {}, []

        def root(name):
            while name in instead:
                name = instead[name]
            return name

        for item in self.items:
            match = _ALIAS.fullmatch(item)
            left, right = map(root, match.groups()) if match else ("", "")
            if not match or self.ranges.get(left) != self.ranges.get(right) or left == right:
                kept.append(item)
            elif _ANONYMOUS.fullmatch(right) and right not in self.ports:
                instead[right] = left
                if self.kinds.pop(right) == "reg":
                    self.kinds[left] = "output reg" if left in self.ports else "reg"
                if right in self.initial:
                    self.initial[left] = self.initial.pop(right)
            elif "$" in left and left not in self.ports:
                instead[left] = right
                del self.kinds[left]
            else:
                kept.append(item)
        self.items = kept
        self._substitute(root)

    def _clock_next_values(self):
        """``always @*`` that computes a register's next value, and what clocks it: one statement."""
        uses, values, found, plain_moves = self._uses(), {}, [], defaultdict(list)
        for item in self.items:
            if item.startswith("  always @* begin"):
                targets = Counter(match[1] for match in _TARGET.findall(item))
                if len(targets) == 1:
                    ((value, count),) = targets.items()
                    values[value] = item, count
        used = set()
        for item in self.items:
            match = _CLOCKED.fullmatch(item)
            clock, register, value = match.groups() if match else ("", "", "")
            block, count = values.get(value, ("", 0))
            if block and uses[value] == count + 1 and value not in self.ports:
                used.add(block)
                del self.kinds[value]
                block = _YOSYS_START.sub("", block).replace("always @*", f"always @(posedge {clock})", 1)
                block = _TARGET.sub(lambda m, r=register: f"{m[1]}{r}{m[3]} <= ", block)
                found.append(block.replace(f" begin\n    {register} <= {register};\n", " begin\n", 1))
            elif match:
                moves = plain_moves[clock]
                if not moves:
                    found.append(moves)
                moves.append(f"    {register} <= {value};")
            else:
                found.append(item)
        clocks = {id(moves): clock for clock, moves in plain_moves.items()}
        self.items = [
            item if isinstance(item, str)
            else "\n".join([f"  always @(posedge {clocks[id(item)]}) begin", *item, "  end"])
            for item in found if not isinstance(item, str) or item not in used
        ]  # fmt: skip

    def _start(self):
        """Where a block reads a register with an initial value, that starts it; elsewhere one register does."""
        items = []
        for item in self.items:
            if match := _YOSYS_START.search(item):
                self.kinds.pop(match[1], None)
                self.initial.pop(match[1], None)
                starts = self.initial.keys() & {*_TOKEN.findall(_YOSYS_START.sub("", item))}
                item = _YOSYS_START.sub("" if starts else f"    if ({_START}) begin end\n", item)
            items.append(item)
        self.items = items
        if self._uses()[_START]:
            self.kinds = {_START: "reg"} | self.kinds
            self.ranges[_START], self.initial[_START] = "", "1'h0"

    def _drop_unread(self):
        """Fields of signals that have no name of their own, and what nothing uses."""
        uses = self._uses()
        fields = {name for name in self.kinds if re.match(r"\\[^.]*\$[^.]*\.", name) and uses[name] == 1}
        self.items = [item for item in self.items if not (fields and {*_TOKEN.findall(item)} & fields)]
        uses = self._uses()
        self.kinds = {name: kind for name, kind in self.kinds.items() if uses[name] or name in self.ports}

    def _rename(self):
        """``\\name$12`` becomes ``name_2``, and ``\\$12`` ``n12``: plain identifiers."""
        taken, renamed = {*self.kinds, *(name.strip("\\ ") for name in self.kinds)}, {}
        for name in sorted(self.kinds, key=lambda n: (n not in self.ports, *map(int, re.findall(r"\$(\d+)", n)))):
            if not ("$" in name or _ANONYMOUS.fullmatch(name)):
                continue
            escaped = re.search(r"[.\[]", name)
            base, number = ("n", 1) if _ANONYMOUS.fullmatch(name) else (
                re.sub(r"\$\d+", "", name[1:-1]).replace("$", ""), 1
            )  # fmt: skip
            while (new := base + str(number) if base == "n" else base if number == 1 else f"{base}_{number}") in taken:
                number += 1
            taken.add(new)
            renamed[name] = f"\\{new} " if escaped else new
        self._substitute(lambda name: renamed.get(name, name))
        for table in ("kinds", "ranges", "initial"):
            setattr(self, table, {renamed.get(name, name): value for name, value in getattr(self, table).items()})
        ports, self.ports = self.ports, [renamed.get(name, name) for name in self.ports]
        return {old: new for old, new in zip(ports, self.ports, strict=True) if old != new}


def _merged(modules, top):
    """Modules whose text is the same but for their name are one, from the innermost on."""
    used = re.compile(r"^(module |  )(\w+)(?=\(| [\w\\])", re.MULTILINE)
    merging = True
    while merging:
        groups, instead = defaultdict(list), {}
        for name, text in modules.items():
            groups[re.sub(rf"^module {name}\(", "module (", text, count=1, flags=re.MULTILINE)].append(name)
        for names in groups.values():
            stems = {re.sub(r"_\d+(?=_|$)", "", name) for name in names}
            new = names[0] if len(stems) > 1 or stems & {*modules, *instead.values()} else stems.pop()
            if len(names) > 1 and top not in names:
                instead |= dict.fromkeys(names, new)
        merging = bool(instead)
        modules = {
            instead.get(name, name): used.sub(lambda m, instead=instead: m[1] + instead.get(m[2], m[2]), text)
            for name, text in modules.items()
        }
    return modules
