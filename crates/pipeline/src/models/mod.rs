//! Finished models: adjustment, exports, undistortion, localisation, tools.

pub(crate) mod adjust;
pub(crate) mod export;
pub(crate) mod kalibr;
pub(crate) mod localize;
pub(crate) mod model_tools;
pub(crate) mod rigid;
pub(crate) mod rolling_shutter;
pub(crate) mod undistort;
