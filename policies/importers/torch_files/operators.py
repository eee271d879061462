"""Operators that files of torch may use: those of policy networks, which check their shapes and indices.

All others are refused: some of torch's operators write outside of their tensors, or read and write files.
"""

_ARITHMETIC = """
    abs absolute acos acosh add addcdiv addcmul arccos arcsin arctan arctan2 asin asinh atan atan2 atanh ceil clamp
    clamp_max clamp_min clip copysign cos cosh cumprod cumsum deg2rad degrees div divide divmod erf erfc erfinv exp exp2
    expm1 fix floor floor_divide floordiv fmod frac hypot lerp log log10 log1p log2 logaddexp logit maximum minimum
    mul multiply nan_to_num neg negative positive pow rad2deg radians reciprocal remainder round rsqrt rsub sgn sign sin
    sinc sinh sqrt square sub subtract tan tanh true_divide trunc xlogy
"""
_LINEAR = """
    _convolution _convolution_mode addbmm addmm addmv addr baddbmm bilinear bmm chain_matmul conv1d conv2d conv3d
    conv_transpose1d conv_transpose2d conv_transpose3d convolution cross dot einsum ger inner kron linalg_cross
    linalg_matrix_norm linalg_norm linalg_vector_norm linear matmul mm mv norm outer
    scaled_dot_product_attention tensordot trace vdot
"""
_LAYERS = """
    _log_softmax _softmax adaptive_avg_pool1d adaptive_avg_pool2d adaptive_max_pool1d adaptive_max_pool2d
    alpha_dropout avg_pool1d avg_pool2d batch_norm celu cosine_similarity dropout elu embedding feature_dropout gelu glu
    group_norm gru gru_cell hardshrink hardsigmoid hardswish hardtanh instance_norm layer_norm leaky_relu log_sigmoid
    log_softmax lstm lstm_cell max_pool1d max_pool2d max_pool2d_with_indices mish native_group_norm native_layer_norm
    prelu relu relu6 rms_norm rnn_relu rnn_relu_cell rnn_tanh rnn_tanh_cell rrelu selu sigmoid silu softmax softplus
    softshrink threshold
"""
_REDUCTIONS = """
    _cdist_forward all amax amin aminmax any argmax argmin argsort cdist count_nonzero cummax cummin dist logcumsumexp
    logsumexp max mean median min nanmean nansum pairwise_distance prod sort std std_mean sum topk var var_mean
"""
_COMPARISONS = """
    __and__ __contains__ __iand__ __ior__ __is__ __isnot__ __ixor__ __lshift__ __not__ __or__ __rshift__ __xor__
    allclose bitwise_and bitwise_not bitwise_or bitwise_xor eq equal fmax fmin ge greater greater_equal gt heaviside
    is_nonzero is_same_size isclose isfinite isinf isnan isneginf isposinf le less less_equal logical_and logical_not
    logical_or logical_xor lt masked_fill ne not_equal signbit where
"""
_SHAPES = """
    __getitem__ alias atleast_1d atleast_2d atleast_3d broadcast_tensors broadcast_to cat chunk column_stack concat
    concatenate constant_pad_nd contiguous diag diag_embed diagonal dsplit dstack expand expand_as flatten flip fliplr
    flipud gather hsplit hstack index index_add index_copy index_fill index_put index_select masked_select meshgrid
    mT moveaxis movedim narrow nonzero one_hot pad permute ravel repeat repeat_interleave reshape reshape_as roll rot90
    row_stack scatter scatter_add select slice split split_with_sizes squeeze stack swapaxes swapdims t
    take_along_dim tensor_split tile transpose tril triu unbind unflatten unfold unsafe_chunk unsafe_split unsqueeze
    view view_as vsplit vstack
"""
_TENSORS = """
    _to_copy arange as_tensor bernoulli clone copy cpu detach device dim empty empty_like eye fill full
    full_like get_device is_autocast_enabled is_complex is_contiguous is_floating_point is_grad_enabled item len
    lift_fresh lift_fresh_copy linspace logspace new_empty new_full new_ones new_zeros normal numel numpy_T ones
    ones_like rand rand_like randint randn randn_like scalar_tensor size stride tensor to type_as zero zeros zeros_like
    Bool Float FloatImplicit Int IntImplicit ScalarImplicit _assert_async _assert_scalar _assert_tensor_metadata
    _local_scalar_dense sym_numel sym_size
"""
_LANGUAGE = """
    __derive_index __range_length _set_item append capitalize clear dict endswith extend find format get hex insert
    isdigit items join keys list lower lstrip ord percentFormat pop popitem remove replace reverse rstrip setdefault
    sorted startswith str strip title update upper values warn
"""
OPERATORS = frozenset(
    f"{_ARITHMETIC}{_LINEAR}{_LAYERS}{_REDUCTIONS}{_COMPARISONS}{_SHAPES}{_TENSORS}{_LANGUAGE}".split()
)
"""Names without the namespace `aten` and without the mark of the variant that works in place."""


def is_operator(name: str) -> bool:
    """Return True for an operator of aten that files may use: `add`, or `add_`, its variant that works in place."""
    return name in OPERATORS or name.removesuffix("_") in OPERATORS
