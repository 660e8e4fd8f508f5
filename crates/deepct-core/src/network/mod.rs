//! The network: layers, weights, and the plan that runs them.
