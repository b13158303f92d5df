"""PTX as C: each instruction becomes a statement, each register a variable.

It is exact but for approximate instructions, which are better here. What threads do together is in
`ptx_threads.c`.
"""

import re

TYPES = {
    "pred": "bool",
    **{f"{kind}{bits}": f"uint{bits}_t" for kind in "bu" for bits in (8, 16, 32, 64)},
    **{f"s{bits}": f"int{bits}_t" for bits in (8, 16, 32, 64)},
    "f32": "float",
    "f64": "double",
}

RARE = "__internal_trig_reduction_slowpathd"
"""For sines of more than 10^5 rad: its carries are not translated, and no vehicle turns so."""

COMPARISONS = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
OPERATORS = {"add": "+", "sub": "-", "and": "&", "or": "|", "xor": "^", "div": "/", "rem": "%"}
FUNCTIONS = {
    "neg": "-({})".format,
    "sqrt": "sqrt({})".format,
    "rcp": "1.0 / {}".format,
    "ex2": "exp2f({})".format,
    # PTX has the sign first.
    "copysign": "copysign({1}, {0})".format,
    # No float is multiplied and added at once.
    "fma": "fma({}, {}, {})".format,
    **{("abs", kind): f"{name}({{}})".format for kind, name in (("f", "fabs"), ("s", "llabs"))},
    **{
        (op, kind): f"{name}({{}}, {{}})".format
        for op, names in {
            "min": ("fmin", "least", "least_positive"),
            "max": ("fmax", "most", "most_positive"),
        }.items()
        for kind, name in zip("fsu", names, strict=True)
    },
}
"""By an instruction, or with the first letter of its type."""
ROUNDED = {"rni": "nearbyint", "rzi": "trunc", "rmi": "floor", "rpi": "ceil"}
SPECIAL = re.compile(r"%(tid|ntid|ctaid|nctaid)\.([xyz])")


class UnknownError(Exception):
    """An instruction that is not translated."""


class Translator:
    """Translates one PTX file."""

    def __init__(self, ptx):
        self.lines = [
            line.partition("//")[0].strip() for line in ptx.replace("\0", "").splitlines()
        ]
        self.registers = {}
        self.declarations = []
        self.output = []

    def translate(self):
        """The file's functions in C, and the types of the entry's parameters."""
        text = "\n".join(line for line in self.lines if line and line[0] != "#")
        for name, size, content in re.findall(
            r"\.global \.align \d+ \.b8 (\w+)\[(\d+)\] = \{([^}]*)\};", text
        ):
            self.output.append(f"static _Alignas(16) const uint8_t {name}[{size}] = {{{content}}};")
        for found in re.finditer(r"^(\.func[^;{]*|\.visible \.entry[^{]*)\{$", text, re.M):
            self._translate_function(found[1], _body(text, found.end()))
        entry = re.search(r"\.visible \.entry \w+\(([^)]*)\)", text)[1]
        return "\n".join(self.declarations + self.output), re.findall(r"\.param \.(\w+) \w+", entry)

    def _translate_function(self, head, body):
        name = re.search(r"(\w+)\s*\((?![^()]*\)\s*\w)", head.replace("\n", " "))[1]
        parameters = re.findall(r"\.param (?:\.align \d+ )?\.(\w+) (\w+)", head)
        if ".entry" in head:
            self.entry = name
            self.output.append("static void entry(uint8_t* const* parameters) {")
            for number, (_, one) in enumerate(parameters):
                self.output.append(f"  uint8_t* const {one} = parameters[{number}];")
        else:
            given = ", ".join(f"uint8_t* {one}" for _, one in parameters)
            self.declarations.append(f"static void {name}({given});")
            self.output.append(f"static void {name}({given}) {{")
            if name == RARE:
                self.output += ['  fail("a rare function");', "}"]
                return
        self.registers = {}
        for kind, prefix, number in re.findall(r"\.reg \.(\w+)\s+%(\w+)<(\d+)>;", body):
            self.registers[prefix] = kind
            for index in range(int(number)):
                self.output.append(f"  {TYPES[kind]} {prefix}{index} = 0;")
        for one in ("SP", "SPL"):
            self.registers[one] = "b64"
        self.output.append("  uint64_t SP = 0, SPL = 0;")
        joined = re.sub(r"\s*\n\s*", " ", re.sub(r"^(\$\w+:)$", r"\1;", body, flags=re.M))
        for statement in re.split(r"(?<=[;{}])", re.sub(r"\{([^{};]*)\}", r"<\1>", joined)):
            self._translate_statement(statement.strip())
        self.output.append("}")

    def _translate_statement(self, statement):
        if not statement or statement in {"{", "}", ";"}:
            self.output.append(statement)
            return
        label = re.fullmatch(r"\$(\w+):;", statement)
        if label:
            self.output.append(f"{label[1]}:;")
            return
        declared = re.fullmatch(
            r"\.(?:param|local) (?:\.align \d+ )?\.b(\d+)\s+(\w+)(?:\[(\d+)\])?;", statement
        )
        if declared:
            size = int(declared[1]) // 8 * int(declared[3] or 1)
            self.output.append(f"  _Alignas(16) uint8_t {declared[2]}[{size}];")
            return
        local = re.fullmatch(r"\.reg \.(\w+)\s+%?([A-Za-z_]\w*);", statement)
        if local:
            self.registers[local[2]] = local[1]
            self.output.append(f"  {TYPES[local[1]]} {local[2]};")
            return
        if statement.startswith((".reg", ".pragma", ".loc")):
            return
        guarded = re.fullmatch(r"(?:@(!?)%(p\d+) )?([\w.]+)\s*(.*);", statement, re.S)
        if guarded is None:
            raise UnknownError(statement)
        negated, predicate, name, operands = guarded.groups()
        code = self._translate(name.split("."), operands)
        condition = f"if ({negated}{predicate}) " if predicate else ""
        self.output.append(f"  {condition}{{ {code} }}")

    def _operand(self, operand, kind):
        """An operand as a number of a type."""
        operand = operand.strip()
        if operand.startswith("%"):
            special = SPECIAL.fullmatch(operand)
            if special:
                return f"self->{special[1]}[{'xyz'.index(special[2])}]"
            if operand == "%laneid":
                return "self->lane"
            register = operand[1:]
            own = self.registers[register.rstrip("0123456789")]
            return _cast(register, TYPES[own], TYPES[kind])
        if operand.startswith(("0d", "0f")):
            bits = operand[2:]
            return f"{'real' if operand[1] == 'd' else 'short_real'}(0x{bits}ull)"
        if re.fullmatch(r"-?\d+", operand):
            return f"(({TYPES[kind]}){int(operand) & (2**64 - 1)}ull)"
        return f"(uint64_t)(uintptr_t){operand}"

    def _assign(self, target, kind, value):
        register = target.strip()[1:]
        own = TYPES[self.registers[register.rstrip("0123456789")]]
        return f"{register} = {_cast(f'({TYPES[kind]})({value})', TYPES[kind], own)};"

    def _place(self, operand):
        base, _, offset = operand.strip()[1:-1].partition("+")
        if base.startswith("%"):
            base = f"(uint8_t*)(uintptr_t){base[1:]}"
        return f"{base} + {offset or 0}"

    def _translate(self, name, operands):
        """An instruction by the method of its name; most are an operator or a function of C."""
        parts = [part.strip() for part in re.split(r",\s*(?![^<]*>)(?![^(]*\))", operands)]
        op, kind = name[0], name[-1]
        method = getattr(self, f"_{op}", None)
        if method is not None:
            return method(name, parts)
        function = FUNCTIONS.get((op, kind[0])) or FUNCTIONS.get(op)
        if op not in OPERATORS and function is None:
            raise UnknownError(f"{'.'.join(name)} {operands}")
        values = [self._operand(part, kind) for part in parts[1:]]
        code = function(*values) if function else f" {OPERATORS[op]} ".join(values)
        return self._assign(parts[0], kind, code)

    def _mov(self, name, parts):
        if parts[1].startswith("<"):
            low, high = (self._operand(part, "b32") for part in parts[1][1:-1].split(","))
            return self._assign(parts[0], "b64", f"(uint64_t){low} | (uint64_t){high} << 32")
        if parts[0].startswith("<"):
            low, high = parts[0][1:-1].split(",")
            whole = self._operand(parts[1], "b64")
            return self._assign(low, "b32", whole) + self._assign(high, "b32", f"{whole} >> 32")
        return self._assign(parts[0], name[-1], self._operand(parts[1], name[-1]))

    def _cvta(self, _, parts):
        return self._assign(parts[0], "b64", self._operand(parts[1], "b64"))

    def _ld(self, name, parts):
        targets, kind = parts[0], name[-1]
        place = self._place(parts[1])
        names = targets[1:-1].split(",") if targets.startswith("<") else [targets]
        # A register may be wider than what is loaded.
        return " ".join(
            self._load(one, kind, f"(({TYPES[kind]}*)({place}))[{number}]")
            for number, one in enumerate(names)
        )

    def _load(self, target, kind, value):
        register = target.strip()[1:]
        own = TYPES[self.registers[register.rstrip("0123456789")]]
        if own in {"float", "double"} or TYPES[kind] in {"float", "double"}:
            return self._assign(target, kind, value)
        return f"{register} = ({own})({value});"

    def _st(self, name, parts):
        kind = name[-1]
        given = parts[1]
        values = given[1:-1].split(",") if given.startswith("<") else [given]
        place = self._place(parts[0])
        return " ".join(
            f"(({TYPES[kind]}*)({place}))[{number}] = {self._store(one, kind)};"
            for number, one in enumerate(values)
        )

    def _store(self, operand, kind):
        register = operand.strip()[1:]
        own = (
            self.registers.get(register.rstrip("0123456789")) if operand.strip()[0] == "%" else None
        )
        if own is not None and "f" not in own + kind:
            return f"({TYPES[kind]}){register}"
        return self._operand(operand, kind)

    def _bra(self, _, parts):
        return f"goto {parts[0][1:]};"

    def _ret(self, *_):
        return "return;"

    def _call(self, _, parts):
        whole = ", ".join(parts)
        result, function, given = re.fullmatch(r"\((\w+)\), (\w+), \(\s*(.*?)\s*\)", whole).groups()
        return f"{function}({', '.join([result, *re.split(r', *', given)])});"

    def _setp(self, name, parts):
        kind, comparison = name[-1], name[1]
        one, other = (self._operand(part, kind) for part in parts[1:])
        code = f"{one} {COMPARISONS[comparison[:2]]} {other}"
        if kind[0] == "f" and comparison == "ne":
            code = f"{one} < {other} || {one} > {other}"
        if len(comparison) == 3:  # ltu: less than, or one of them is not a number
            code = f"{one} != {one} || {other} != {other} || {code}"
        return f"{parts[0][1:]} = {code};"

    def _selp(self, name, parts):
        one, other = (self._operand(part, name[-1]) for part in parts[1:3])
        return self._assign(parts[0], name[-1], f"{parts[3][1:]} ? {one} : {other}")

    def _not(self, name, parts):
        sign = "!" if name[-1] == "pred" else "~"
        return self._assign(parts[0], name[-1], f"{sign}{self._operand(parts[1], name[-1])}")

    def _mul(self, name, parts):
        kind = name[-1]
        values = [self._operand(part, kind) for part in parts[1:]]
        if "wide" in name:
            wide = f"{kind[0]}{2 * int(kind[1:])}"
            return self._assign(
                parts[0], wide, " * ".join(f"({TYPES[wide]}){value}" for value in values)
            )
        if "hi" in name:
            bits = int(kind[1:])
            wider = {("s", 64): "__int128", ("u", 64): "unsigned __int128"}.get(
                (kind[0], bits), "int64_t" if kind[0] == "s" else "uint64_t"
            )
            return self._assign(
                parts[0], kind, f"(({wider}){values[0]} * ({wider}){values[1]}) >> {bits}"
            )
        return self._assign(parts[0], kind, " * ".join(values))

    def _mad(self, name, parts):
        kind = name[-1]
        values = [self._operand(part, kind) for part in parts[1:]]
        if "wide" in name:
            wide = f"{kind[0]}{2 * int(kind[1:])}"
            product = " * ".join(f"({TYPES[wide]}){value}" for value in values[:2])
            return self._assign(parts[0], wide, f"{product} + {self._operand(parts[3], wide)}")
        if name[1] != "lo" or "cc" in name:
            raise UnknownError(".".join(name))
        return self._assign(parts[0], kind, f"{values[0]} * {values[1]} + {values[2]}")

    def _shl(self, name, parts):
        return self._shift("<<", name, parts)

    def _shr(self, name, parts):
        return self._shift(">>", name, parts)

    def _shift(self, sign, name, parts):
        kind = name[-1]
        value, by = self._operand(parts[1], kind), self._operand(parts[2], "u32")
        bits = int(kind[1:])
        beyond = f"({value} < 0 ? -1 : 0)" if kind[0] == "s" and sign == ">>" else "0"
        return self._assign(parts[0], kind, f"{by} < {bits} ? {value} {sign} {by} : {beyond}")

    def _bfi(self, name, parts):
        kind = name[-1]
        piece, into = (self._operand(part, kind) for part in parts[1:3])
        start, length = int(parts[3]), int(parts[4])
        mask = ((1 << length) - 1) << start
        return self._assign(
            parts[0], kind, f"({into} & ~{mask}ull) | (({piece} << {start}) & {mask}ull)"
        )

    def _cvt(self, name, parts):
        target, source = name[-2:]
        value = self._operand(parts[1], source)
        for mode, function in ROUNDED.items():
            if mode in name:
                value = f"{function}({value})"
                if target[0] != "f":
                    return self._assign(parts[0], target, f"saturated_{target}({value})")
        register = parts[0].strip()[1:]
        own = TYPES[self.registers[register.rstrip("0123456789")]]
        if target[0] != "f":
            # A wider register gets the sign or zeros.
            return f"{register} = ({own})({TYPES[target]})({value});"
        return self._assign(parts[0], target, f"({TYPES[target]})({value})")

    def _bar(self, _, parts):
        return f"meet({self._operand(parts[0], 'u32')}, 0);"

    def _vote(self, name, parts):
        if "any" not in name:
            raise UnknownError(".".join(name))
        flag, mask = self._operand(parts[1], "pred"), self._operand(parts[2], "u32")
        return f"{parts[0][1:]} = any_of({mask}, {flag});"

    def _shfl(self, name, parts):
        if "bfly" not in name:
            raise UnknownError(".".join(name))
        value, distance, _, mask = (self._operand(part, "u32") for part in parts[1:])
        return self._assign(
            parts[0].partition("|")[0], "b32", f"of_other({mask}, {value}, {distance})"
        )


def _body(text, start):
    """What is between a brace, before ``start``, and the one that closes it."""
    depth = 1
    for found in re.finditer(r"[{}]", text[start:]):
        depth += 1 if found[0] == "{" else -1
        if depth == 0:
            return text[start : start + found.start()]
    raise UnknownError("no end")


def _cast(value, own, wanted):
    """A value of one type as another: the bits, if one is real and they are of equal size."""
    if own == wanted or "bool" in (own, wanted):
        return value if own == wanted else f"(({wanted}){value})"
    if "double" in (own, wanted):
        return f"real({value})" if wanted == "double" else f"(({wanted})bits({value}))"
    if "float" in (own, wanted):
        return f"short_real({value})" if wanted == "float" else f"(({wanted})short_bits({value}))"
    return f"(({wanted}){value})"
