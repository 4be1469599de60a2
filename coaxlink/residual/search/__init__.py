"""Which effects the residual demands: trials, change points, time trends, and the joint fit."""
