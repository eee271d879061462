import numpy as np
from onnx import TensorProto, helper, numpy_helper

MJLAB = {
    "run_path": "local",
    "joint_names": "FR_hip_joint,FR_thigh_joint,FR_calf_joint",
    "joint_stiffness": "20.900,20.900,38.300",
    "joint_damping": "1.330,1.330,2.440",
    "default_joint_pos": "0.100,0.900,-1.800",
    "command_names": "twist",
    "observation_names": "base_lin_vel,base_ang_vel,projected_gravity,joint_pos,joint_vel,actions,command,height_scan",
    "observation_terms_scale": "1.000,0.250,1.000,1.000,0.050,1.000,2.000;2.000;0.250,0.200",
    "observation_terms_flatten_history_dim": "1.000,1.000,1.000,1.000,1.000,1.000,1.000,1.000",
    "observation_terms_history_length": "0.000,0.000,0.000,5.000,5.000,0.000,0.000,0.000",
    "observation_terms_clip": (
        "-inf;inf,-inf;inf,-inf;inf,-inf;inf,-100.000;100.000,-inf;1.000,-inf;inf,-inf;inf"
    ),
    "action_scale": "0.373,0.373,0.240",
}
"""What get_base_metadata and attach_metadata_to_onnx of mjlab 1.6.0 wrote for three joints of a leg."""


def graph(metadata, observations=4, actions=3):
    weights = numpy_helper.from_array(np.ones((observations, actions), np.float32), "w")
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size])
        for name, size in (("obs", observations), ("actions", actions))
    ]
    nodes = [helper.make_node("MatMul", ["obs", "w"], ["actions"])]
    model = helper.make_model(
        helper.make_graph(nodes, "policy", [ends[0]], [ends[1]], [weights]),
        opset_imports=[helper.make_opsetid("", 18)],
        ir_version=9,
    )
    helper.set_model_props(model, metadata)
    return model
