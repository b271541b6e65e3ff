"""A small multilayer perceptron of values that a shader knows about the receiver."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arithmetic import as_float, at_least, concrete
from ..._checks import check_value
from ...settings.biases import Number
from .._receiver import Receiver
from .._shader import Constant, ShaderBias, ShaderPart, joined, numbers
from ._abstract import AbstractBias, BiasTerms, in_depth, shader_of_length
from ._features import FEATURES
from ._linear import LinearBias

MAX_WEIGHTS = 100
"""The maximum number of weights of a perceptron, including its linear terms. A shader evaluates them for each pixel."""


class PerceptronBias(AbstractBias):
    """A linear bias and a perceptron that corrects it, `max(0, linear + wₙ · tanh(... tanh(W₁ x + b₁) ...))`, in texels
    along the light's axis.

    The perceptron's inputs are the features of the linear terms except `one`, each squashed to `x = f / (1 + f)`.

    - `linear`: the linear terms.
    - `hidden`: the hidden layers, the first layer first; each has a `weight` (out, in) and a `bias` (out,).
    - `last`: (n,), the weights of the last hidden layer's values, in texels.

    **Raises** `ValueError` if the layers' sizes do not fit together, there are more than `MAX_WEIGHTS` weights, or one
    is out of its range.
    """

    linear: LinearBias
    hidden: tuple[eqx.nn.Linear, ...]
    last: Float[Array, " n"]

    @classmethod
    def correcting(cls, linear: LinearBias, sizes: Sequence[int] = (8,), seed: int = 0) -> "PerceptronBias":
        """A perceptron with the same result as `linear`: its last weights are 0, and the weights of its hidden layers
        are random.

        **Arguments:**

        - `sizes`: sizes of the hidden layers.

        **Raises** the errors of the class.
        """
        keys = jax.random.split(jax.random.key(seed), len(sizes))
        widths = [len(_inputs(linear)), *sizes]
        layers = [
            eqx.nn.Linear(before, after, key=key, dtype=jnp.result_type(float))
            for before, after, key in zip(widths, sizes, keys, strict=False)
        ]
        return cls(linear, tuple(layers), jnp.zeros(widths[-1]))

    @classmethod
    def of(
        cls,
        linear: LinearBias,
        hidden: Sequence[tuple[Sequence[Sequence[float]], Sequence[float]]],
        last: Sequence[float],
    ) -> "PerceptronBias":
        """The perceptron with these numbers: for each hidden layer the weights, row by row, and the biases.

        **Raises** the errors of the class, and `ValueError` if rows of weights differ in length.
        """
        layers = []
        for weight, bias in hidden:
            lengths = {len(row) for row in weight}
            if len(lengths) != 1:
                raise ValueError(f"rows of the perceptron's weights have lengths {sorted(lengths)}; expected all equal")
            # Only its shape, because random numbers take time to compile.
            empty = eqx.filter_eval_shape(eqx.nn.Linear, lengths.pop(), len(weight), key=jax.random.key(0))
            layers.append(eqx.tree_at(lambda x: (x.weight, x.bias), empty, (as_float(weight), as_float(bias))))
        return cls(linear, tuple(layers), as_float(last))

    def _check_rules(self):
        inputs = len(self.inputs)
        shapes = [layer.weight.shape for layer in self.hidden]
        before = [inputs, *(rows for rows, _ in shapes)]
        fits = bool(shapes) and before == [*(columns for _, columns in shapes), self.last.size]
        biased = all(layer.bias is not None and layer.bias.shape == layer.weight.shape[:1] for layer in self.hidden)
        if not (fits and biased):
            given = ", ".join(f"{rows} x {columns}" for rows, columns in [*shapes, (1, self.last.size)])
            raise ValueError(
                f"the perceptron has {inputs} inputs and layers of {given} weights; expected one or more hidden "
                "layers, where the columns of each layer match the rows of the layer before, and a bias for each row"
            )
        if self.count > MAX_WEIGHTS:
            raise ValueError(
                f"the perceptron has {self.count} weights; expected at most {MAX_WEIGHTS}: use smaller layers, or "
                "fewer terms"
            )
        for known in map(concrete, jax.tree.leaves(eqx.filter((self.hidden, self.last), eqx.is_inexact_array))):
            for number in () if known is None else np.ravel(known):
                check_value("a weight of the PerceptronBias", number, Number)

    @property
    def weights(self) -> dict[str, Any]:
        """The weights of the linear terms."""
        return self.linear.weights

    @property
    def inputs(self) -> tuple[str, ...]:
        """The names of the features that the perceptron sees."""
        return _inputs(self.linear)

    @property
    def count(self) -> int:
        """The number of weights, including the weights of the linear terms."""
        return sum(leaf.size for leaf in jax.tree.leaves(eqx.filter(self, eqx.is_inexact_array)))

    def __call__(self, receiver: Receiver) -> BiasTerms:
        values = jnp.stack([_squashed(FEATURES[name].of(receiver)) for name in self.inputs])
        for layer in self.hidden:
            offset = jnp.asarray(layer.bias)[:, None, None]
            values = jnp.tanh(_weighted(layer.weight, values) + offset)
        total = self.linear.total(receiver) + _weighted(self.last[None], values)[0]
        return BiasTerms(in_depth(at_least(total, as_float(0)), "texels", receiver))

    def shader(self, prefix: str = "") -> ShaderBias:
        linear, total = self.linear.shader_total(prefix)
        constants: list[Constant] = []
        lines = ["float shadow_perceptron(ShadowReceiver at) {", f"    float x0[{len(self.inputs)}];"]
        for i, name in enumerate(self.inputs):
            lines += [f"    float f{i} = {FEATURES[name].shader};", f"    x0[{i}] = f{i} / (1.0 + f{i});"]
        for layer, found in enumerate(self.hidden):
            rows, columns = found.weight.shape
            names = f"{prefix}LAYER_{layer}", f"{prefix}OFFSETS_{layer}"
            constants += [
                Constant(names[0], numbers(found.weight), f"of hidden layer {layer}, row by row"),
                Constant(names[1], numbers(found.bias), f"of hidden layer {layer}"),
            ]
            lines += [
                f"    float x{layer + 1}[{rows}];",
                f"    for (int i = 0; i < {rows}; i++) {{",
                f"        float sum = SHADOW_{names[1]}[i];",
                f"        for (int j = 0; j < {columns}; j++) {{",
                f"            sum += SHADOW_{names[0]}[i * {columns} + j] * x{layer}[j];",
                "        }",
                f"        x{layer + 1}[i] = tanh(sum);",
                "    }",
            ]
        constants.append(Constant(f"{prefix}LAST_LAYER", numbers(self.last), "in texels"))
        last = len(self.hidden)
        lines += [
            f"    float total = {total};",
            f"    for (int i = 0; i < {self.last.size}; i++) {{",
            f"        total += SHADOW_{prefix}LAST_LAYER[i] * x{last}[i];",
            "    }",
            "    return max(total, 0.0);",
            "}",
            "",
        ]
        part = joined([linear, ShaderPart(tuple(constants), "\n".join(lines))])
        return ShaderBias(part, (shader_of_length("shadow_perceptron(at)", "texels"),))


def _inputs(linear: LinearBias) -> tuple[str, ...]:
    # In the order of the table, because JAX sorts the keys of mappings.
    return tuple(name for name in FEATURES if name in linear.weights and name != "one")


def _squashed(feature: Float[Array, "h w"]) -> Float[Array, "h w"]:
    return feature / (1 + feature)


def _weighted(weight: Float[Array, "m n"], values: Float[Array, "n h w"]) -> Float[Array, "m h w"]:
    return jnp.tensordot(weight, values, 1, precision="highest")
