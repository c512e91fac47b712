from collections.abc import Iterable

from ...codegen import Expressions, Operation, Value


# Values that weights take part in, as factors of a product, by their indices in ascending order;
# none of what patterns alone decide.
Product = tuple[int, ...]
# A sum of products, each times what patterns alone decide.
Form = dict[Product, Value]


class Collected:
    """An expression's values again, with what patterns alone decide collected in front of what
    weights decide.

    `a * x * w + b * w` becomes `(a * x + b) * w`, where patterns decide the bracket and a kernel
    reads it: of the links from several inputs to a node that share a weight, one product is left.
    A modulus of a product becomes the product of moduli; a quotient that is zero where the divisor
    is zero, a product with an `inverse` that is; and a value times its own inverse, whether it
    is `nonzero`, so that a node that one weight alone leads to is divided by nothing.

    **Attributes**

    - `graph`: of the new values.
    """

    def __init__(self, source: Expressions) -> None:
        self._source, self.graph = source, Expressions()
        self._forms: dict[int, Form] = {}
        self._of_weights: dict[int, bool] = {}  # whether weights alone decide a factor
        self._made: dict[int, Form] = {}

    def sum_of(self, value: Value) -> Form:
        """A value of the source as a sum of products."""
        for index in self._source.needed([value]):
            if index not in self._forms:
                self._forms[index] = self._form(self._source.operations[index])
        return self._forms[value.index]

    def factors(self, value: Value) -> tuple[Form, Product]:
        """The same as a sum and the weights' factor of all of it, where the value is a product."""
        operation = value.operation
        if operation.name == "negate":
            form, common = self.factors(value.signed()[1])
            return _negative(form), common
        if operation.name == "multiply":
            forms = [self.sum_of(Value(self._source, i)) for i in operation.arguments]
            for one, other in (forms, forms[::-1]):
                if len(one) == 1 and self._by_weights(next(iter(one))):
                    ((product, coefficient),) = one.items()
                    parts = [self._product(key, product) for key in other]
                    common = tuple(i for i in product if all(i in part for part in parts))
                    remaining = [tuple(i for i in part if i not in common) for part in parts]
                    if not any(self._by_weights((i,)) for part in remaining for i in part):
                        coefficients = [coefficient * x for x in other.values()]
                        return _added(zip(remaining, coefficients, strict=True)), common
        return self.sum_of(value), ()

    def value(self, form: Form) -> Value:
        """A value that is the sum."""
        graph = self.graph
        if not form:
            return graph.constant(0.0)
        minus = _minus(form)
        total = graph.constant(0.0)
        for product, coefficient in sorted(form.items()):
            total += (-coefficient if minus else coefficient) * self.product_value(product)
        turned, size = total.signed()
        if not self._is_pattern(form):
            self._of_weights.setdefault(size.index, self._sum_by_weights(form))
            self._made.setdefault(size.index, _negative(form) if minus != turned else form)
        return -size if minus != turned else size

    def product_value(self, product: Product) -> Value:
        value = self.graph.constant(1.0)
        for index in product:
            value *= Value(self.graph, index)
        return value

    def made_of(self, factor: int) -> Form:
        """The sum that a factor is, itself if it is none."""
        return self._made.get(factor, {(factor,): self.graph.constant(1.0)})

    def _form(self, operation: Operation) -> Form:
        graph = self.graph
        arguments = [self._forms[i] for i in operation.arguments]
        match operation.name:
            case "input":
                value = graph.input(operation.text)
                if not operation.text.startswith("weight"):
                    return {(): value}
                self._of_weights[value.index] = True
                return {(value.index,): graph.constant(1.0)}
            case "constant":
                return _added([((), graph.constant(operation.number))])
            case "add":
                return _added(pair for form in arguments for pair in form.items())
            case "subtract":
                return _added([*arguments[0].items(), *_negative(arguments[1]).items()])
            case "negate":
                return _negative(arguments[0])
            case "multiply":
                return self._times(*arguments)
            case "fabs":
                return self._modulus(arguments[0])
            case "choose" if (quotient := self._quotient(operation)) is not None:
                return quotient
            case name:
                values = [self.value(form) for form in arguments]
                return self._applied(name, *values)

    def _times(self, x: Form, y: Form) -> Form:
        if len(x) > 1:
            x, y = y, x
        if len(x) > 1:
            x = self._single(x)
        if not x or not y:
            return {}
        ((product, coefficient),) = x.items()
        if len(y) > 1 and (product or coefficient.signed()[1].number is None):
            y = self._single(y)
        return _added((self._product(product, key), coefficient * c) for key, c in y.items())

    def _single(self, form: Form) -> Form:
        """A sum as one factor."""
        if len(form) < 2:
            return form
        minus, value = self.value(form).signed()
        one = self.graph.constant(1.0)
        return {(value.index,): -one if minus else one}

    def _modulus(self, form: Form) -> Form:
        graph = self.graph
        return _added(
            (
                tuple(sorted(self._function("fabs", i) for i in product)),
                _pattern_modulus(graph, coefficient),
            )
            for product, coefficient in self._single(form).items()
        )

    def _inverse(self, form: Form) -> Form:
        single = self._single(form)
        return {
            tuple(sorted(self._function("inverse", i) for i in product)): _inverse(
                self.graph, coefficient
            )
            for product, coefficient in single.items()
        }

    def _function(self, name: str, factor: int) -> int:
        operation = self.graph.operations[factor]
        if name == "fabs" and operation.name in ("fabs", "nonzero"):
            return factor
        value = self.graph.apply(name, Value(self.graph, factor))
        self._of_weights[value.index] = self._of_weights[factor]
        return value.index

    def _product(self, x: Product, y: Product) -> Product:
        """Of both, and a value times its own inverse as whether it is not zero."""
        factors = sorted((*x, *y))
        while True:
            pair = next(
                (
                    (i, j, name)
                    for i in factors
                    for name, inverse in (("nonzero", "inverse"), ("", "nonzero"))
                    for j in factors
                    if self.graph.operations[j] == Operation(inverse, (i,))
                ),
                None,
            )
            if pair is None:
                return tuple(factors)
            i, j, name = pair
            factors.remove(j)
            if name:
                factors.remove(i)
                factors = sorted((*factors, self._function(name, i)))

    def _quotient(self, operation: Operation) -> Form | None:
        """Of `x == 0 ? 0 : y * reciprocal(x == 0 ? 1 : x)`."""
        operations = self._source.operations
        condition, otherwise, then = (operations[i] for i in operation.arguments)
        if condition.name != "equal" or then != Operation("constant"):
            return None
        divisor = [i for i in condition.arguments if operations[i] != Operation("constant")]
        if len(divisor) != 1 or otherwise.name != "multiply":
            return None
        for i, j in (otherwise.arguments, otherwise.arguments[::-1]):
            if operations[j].name != "reciprocal":
                continue
            denominator = operations[operations[j].arguments[0]]
            if denominator.name != "choose" or denominator.arguments[:2] != (
                operation.arguments[0],
                divisor[0],
            ):
                continue
            if operations[denominator.arguments[2]] == Operation("constant", number=1.0):
                inverse = self._inverse(self._forms[divisor[0]])
                return self._one_factor(self._times(self._forms[i], inverse))
        return None

    def _one_factor(self, form: Form) -> Form:
        """Of each product, what weights do not decide alone as one factor, computed once."""
        one: Form = {}
        for product, coefficient in form.items():
            mixed = tuple(i for i in product if self._is_mixed(i))
            if len(mixed) > 1:
                value = self.product_value(mixed)
                self._of_weights.setdefault(value.index, False)
                kept = [i for i in product if i not in mixed]
                one[tuple(sorted((*kept, value.index)))] = coefficient
            else:
                one[product] = coefficient
        return one

    def _is_mixed(self, factor: int) -> bool:
        nonzero = self.graph.operations[factor].name == "nonzero"
        return not nonzero and not self._of_weights[factor]

    def _applied(self, name: str, *values: Value) -> Form:
        graph = self.graph
        makers = {"equal": graph.equal, "choose": graph.choice}
        make = makers.get(name, lambda x: graph.apply(name, x))
        value = make(*values)
        known = [self._of_weights[v.index] for v in values if v.index in self._of_weights]
        if not known:
            return {(): value}
        numbers = (v.number is not None or v.index in self._of_weights for v in values)
        self._of_weights[value.index] = all(known) and all(numbers)
        return {(value.index,): self.graph.constant(1.0)}

    def _by_weights(self, product: Product) -> bool:
        return bool(product) and all(self._of_weights[i] for i in product)

    def _sum_by_weights(self, form: Form) -> bool:
        return all(
            self._by_weights(product) and x.signed()[1].number is not None
            for product, x in form.items()
        )

    @staticmethod
    def _is_pattern(form: Form) -> bool:
        return all(not product for product in form)


def _added(pairs: Iterable[tuple[Product, Value]]) -> Form:
    form: Form = {}
    for product, coefficient in pairs:
        total = form[product] + coefficient if product in form else coefficient
        form[product] = total
    return {product: x for product, x in form.items() if not x.is_zero}


def _negative(form: Form) -> Form:
    return {product: -x for product, x in form.items()}


def _minus(form: Form) -> bool:
    """Whether the first coefficient has a minus: of a sum and its negative, one is computed."""
    return min(form.items(), key=lambda item: item[0])[1].signed()[0]


def _pattern_modulus(graph: Expressions, x: Value) -> Value:
    size = x.signed()[1]
    return (
        size
        if size.number is not None or size.operation.name == "fabs"
        else graph.apply("fabs", size)
    )


def _inverse(graph: Expressions, x: Value) -> Value:
    minus, size = x.signed()
    if size.number is not None:
        inverse = graph.constant(1.0 / size.number if size.number else 0.0)
    else:
        inverse = graph.apply("inverse", size)
    return -inverse if minus else inverse
