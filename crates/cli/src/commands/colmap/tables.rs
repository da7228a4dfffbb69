//! COLMAP's options as data. Names are those of COLMAP 3; [`ALIASES`] has the names of COLMAP 4.
//!
//! [`Fixed`] is for options that ask for other results than this program can give, [`Tuning`] for
//! numbers that steer COLMAP's own methods on the way to a result.

use super::spec::Effect::{self, Fixed, Speed, Tuning, Used};
use super::spec::{Kind, Spec};

const fn bool(name: &'static str, default: &'static str, effect: Effect) -> Spec {
    Spec { name, kind: Kind::Bool, default, effect }
}

const fn int(name: &'static str, default: &'static str, effect: Effect) -> Spec {
    Spec { name, kind: Kind::Int, default, effect }
}

const fn real(name: &'static str, default: &'static str, effect: Effect) -> Spec {
    Spec { name, kind: Kind::Real, default, effect }
}

const fn text(name: &'static str, default: &'static str, effect: Effect) -> Spec {
    Spec { name, kind: Kind::Text, default, effect }
}

const fn path(name: &'static str, default: &'static str, effect: Effect) -> Spec {
    Spec { name, kind: Kind::Path, default, effect }
}

/// Options of all verbs.
pub(super) const GENERAL: &[Spec] = &[
    int("random_seed", "0", Used),
    bool("log_to_stderr", "0", Speed),
    int("log_level", "2", Speed),
    text("log_target", "", Speed),
    bool("log_color", "1", Speed),
    int("default_random_seed", "0", Speed),
    path("project_path", "", Used),
];

/// The database.
pub(super) const DATABASE: &[Spec] = &[path("database_path", "", Used)];

/// The folder of the images.
pub(super) const IMAGES: &[Spec] = &[path("image_path", "", Used)];

/// The model to read.
pub(super) const INPUT: &[Spec] = &[path("input_path", "", Used)];

/// The folder or file to write.
pub(super) const OUTPUT: &[Spec] = &[path("output_path", "", Used)];

/// The list of the images to take.
pub(super) const IMAGE_LIST: &[Spec] = &[path("image_list_path", "", Used)];

/// Options of `feature_extractor`.
pub(super) const EXTRACTION: &[Spec] = &[
    int("camera_mode", "-1", Used),
    text("descriptor_normalization", "l1_root", Used),
    path("ImageReader.mask_path", "", Used),
    text("ImageReader.camera_model", "SIMPLE_RADIAL", Used),
    bool("ImageReader.single_camera", "0", Used),
    bool("ImageReader.single_camera_per_folder", "0", Used),
    bool("ImageReader.single_camera_per_image", "0", Used),
    int("ImageReader.existing_camera_id", "-1", Used),
    text("ImageReader.camera_params", "", Used),
    real("ImageReader.default_focal_length_factor", "1.2", Used),
    path("ImageReader.camera_mask_path", "", Used),
    int("SiftExtraction.num_threads", "-1", Speed),
    bool("SiftExtraction.use_gpu", "1", Speed),
    text("SiftExtraction.gpu_index", "-1", Speed),
    int("SiftExtraction.max_image_size", "3200", Used),
    int("SiftExtraction.max_num_features", "8192", Used),
    int("SiftExtraction.first_octave", "-1", Used),
    int("SiftExtraction.num_octaves", "4", Used),
    int("SiftExtraction.octave_resolution", "3", Used),
    real("SiftExtraction.peak_threshold", "0.0066666666666666671", Used),
    real("SiftExtraction.edge_threshold", "10", Used),
    bool("SiftExtraction.estimate_affine_shape", "0", Fixed),
    int("SiftExtraction.max_num_orientations", "2", Used),
    bool("SiftExtraction.upright", "0", Used),
    bool("SiftExtraction.darkness_adaptivity", "0", Fixed),
    bool("SiftExtraction.domain_size_pooling", "0", Used),
    real("SiftExtraction.dsp_min_scale", "0.16666666666666666", Used),
    real("SiftExtraction.dsp_max_scale", "3", Used),
    int("SiftExtraction.dsp_num_scales", "10", Used),
    text("SiftExtraction.normalization", "l1_root", Used),
    text("FeatureExtraction.type", "SIFT", Fixed),
];

/// Options of all matchers.
pub(super) const MATCHING: &[Spec] = &[
    int("SiftMatching.num_threads", "-1", Speed),
    bool("SiftMatching.use_gpu", "1", Speed),
    text("SiftMatching.gpu_index", "-1", Speed),
    real("SiftMatching.max_ratio", "0.8", Used),
    real("SiftMatching.max_distance", "0.7", Used),
    bool("SiftMatching.cross_check", "1", Used),
    bool("SiftMatching.cpu_brute_force_matcher", "0", Speed),
    real("SiftMatching.max_error", "4", Used),
    int("SiftMatching.max_num_matches", "32768", Tuning),
    real("SiftMatching.confidence", "0.999", Tuning),
    int("SiftMatching.max_num_trials", "10000", Tuning),
    real("SiftMatching.min_inlier_ratio", "0.25", Tuning),
    int("SiftMatching.min_num_inliers", "15", Used),
    bool("SiftMatching.multiple_models", "0", Fixed),
    bool("SiftMatching.guided_matching", "0", Fixed),
    bool("SiftMatching.planar_scene", "0", Fixed),
    bool("SiftMatching.compute_relative_pose", "0", Speed),
    real("SiftMatching.lightglue_min_score", "0.1", Speed),
    text("FeatureMatching.type", "SIFT_BRUTEFORCE", Fixed),
    bool("FeatureMatching.skip_geometric_verification", "0", Fixed),
    bool("FeatureMatching.rig_verification", "0", Fixed),
    bool("FeatureMatching.skip_image_pairs_in_same_frame", "0", Fixed),
    real("TwoViewGeometry.min_E_F_inlier_ratio", "0.95", Used),
    real("TwoViewGeometry.max_H_inlier_ratio", "0.8", Used),
    real("TwoViewGeometry.watermark_min_inlier_ratio", "0.7", Tuning),
    real("TwoViewGeometry.watermark_border_size", "0.1", Tuning),
    bool("TwoViewGeometry.detect_watermark", "1", Tuning),
    bool("TwoViewGeometry.multiple_ignore_watermark", "1", Tuning),
    bool("TwoViewGeometry.filter_stationary_matches", "0", Fixed),
    real("TwoViewGeometry.stationary_matches_max_error", "4", Tuning),
    bool("TwoViewGeometry.use_degensac", "0", Tuning),
    int("TwoViewGeometry.random_seed", "-1", Tuning),
];

/// Options of `exhaustive_matcher`.
pub(super) const EXHAUSTIVE: &[Spec] = &[int("ExhaustiveMatching.block_size", "50", Speed)];

/// Options of `sequential_matcher`.
pub(super) const SEQUENTIAL: &[Spec] = &[
    int("SequentialMatching.overlap", "10", Used),
    bool("SequentialMatching.quadratic_overlap", "1", Used),
    bool("SequentialMatching.expand_rig_images", "1", Tuning),
    bool("SequentialMatching.loop_detection", "0", Used),
    int("SequentialMatching.loop_detection_period", "10", Tuning),
    int("SequentialMatching.loop_detection_num_images", "50", Used),
    int("SequentialMatching.loop_detection_min_index_distance", "0", Tuning),
    int("SequentialMatching.loop_detection_num_nearest_neighbors", "1", Tuning),
    int("SequentialMatching.loop_detection_num_checks", "256", Tuning),
    int("SequentialMatching.loop_detection_num_images_after_verification", "0", Tuning),
    int("SequentialMatching.loop_detection_max_num_features", "-1", Tuning),
    path("SequentialMatching.vocab_tree_path", "", Tuning),
    int("SequentialMatching.num_threads", "-1", Speed),
];

/// Options of `vocab_tree_matcher`.
pub(super) const VOCAB_TREE: &[Spec] = &[
    int("VocabTreeMatching.num_images", "100", Used),
    int("VocabTreeMatching.num_nearest_neighbors", "5", Tuning),
    int("VocabTreeMatching.num_checks", "256", Tuning),
    int("VocabTreeMatching.num_images_after_verification", "0", Tuning),
    int("VocabTreeMatching.max_num_features", "-1", Tuning),
    path("VocabTreeMatching.vocab_tree_path", "", Tuning),
    path("VocabTreeMatching.match_list_path", "", Fixed),
    int("VocabTreeMatching.num_threads", "-1", Speed),
];

/// Options of `mapper`, `point_triangulator` and `image_registrator`.
pub(super) const MAPPER: &[Spec] = &[
    int("Mapper.min_num_matches", "15", Used),
    bool("Mapper.ignore_watermarks", "0", Fixed),
    bool("Mapper.multiple_models", "1", Used),
    int("Mapper.max_num_models", "50", Used),
    int("Mapper.max_model_overlap", "20", Tuning),
    int("Mapper.min_model_size", "10", Used),
    int("Mapper.init_image_id1", "-1", Fixed),
    int("Mapper.init_image_id2", "-1", Fixed),
    int("Mapper.init_num_trials", "200", Tuning),
    bool("Mapper.extract_colors", "1", Used),
    int("Mapper.num_threads", "-1", Speed),
    real("Mapper.min_focal_length_ratio", "0.1", Tuning),
    real("Mapper.max_focal_length_ratio", "10", Tuning),
    real("Mapper.max_extra_param", "1", Tuning),
    bool("Mapper.ba_refine_focal_length", "1", Used),
    bool("Mapper.ba_refine_principal_point", "0", Used),
    bool("Mapper.ba_refine_extra_params", "1", Used),
    bool("Mapper.ba_refine_sensor_from_rig", "1", Used),
    int("Mapper.ba_min_num_residuals_for_multi_threading", "50000", Speed),
    int("Mapper.ba_local_num_images", "6", Used),
    real("Mapper.ba_local_function_tolerance", "0", Tuning),
    int("Mapper.ba_local_max_num_iterations", "25", Tuning),
    int("Mapper.ba_local_max_refinements", "2", Tuning),
    real("Mapper.ba_local_max_refinement_change", "0.001", Tuning),
    text("Mapper.ba_local_backend", "CERES", Speed),
    bool("Mapper.ba_global_use_pba", "0", Speed),
    int("Mapper.ba_global_pba_gpu_index", "-1", Speed),
    real("Mapper.ba_global_images_ratio", "1.1", Used),
    real("Mapper.ba_global_points_ratio", "1.1", Tuning),
    int("Mapper.ba_global_images_freq", "500", Tuning),
    int("Mapper.ba_global_points_freq", "250000", Tuning),
    real("Mapper.ba_global_function_tolerance", "0", Tuning),
    int("Mapper.ba_global_max_num_iterations", "50", Tuning),
    int("Mapper.ba_global_max_refinements", "5", Tuning),
    real("Mapper.ba_global_max_refinement_change", "0.0005", Tuning),
    bool("Mapper.ba_global_ignore_redundant_points3D", "0", Speed),
    real("Mapper.ba_global_prune_points_min_coverage_gain", "0.05", Tuning),
    text("Mapper.ba_global_backend", "CERES", Speed),
    bool("Mapper.ba_use_gpu", "0", Speed),
    text("Mapper.ba_gpu_index", "-1", Speed),
    bool("Mapper.use_prior_position", "0", Fixed),
    bool("Mapper.use_robust_loss_on_prior_position", "0", Tuning),
    real("Mapper.prior_position_loss_scale", "7.815", Tuning),
    bool("Mapper.structure_less_registration_fallback", "1", Tuning),
    bool("Mapper.structure_less_registration_only", "0", Fixed),
    text("Mapper.image_selection_method", "MIN_UNCERTAINTY", Tuning),
    int("Mapper.random_seed", "-1", Used),
    int("Mapper.max_runtime_seconds", "-1", Fixed),
    path("Mapper.constant_rig_list_path", "", Fixed),
    path("Mapper.constant_camera_list_path", "", Fixed),
    path("Mapper.snapshot_path", "", Fixed),
    int("Mapper.snapshot_images_freq", "0", Tuning),
    bool("Mapper.fix_existing_images", "0", Used),
    int("Mapper.init_min_num_inliers", "100", Tuning),
    real("Mapper.init_max_error", "4", Tuning),
    real("Mapper.init_max_forward_motion", "0.95", Tuning),
    real("Mapper.init_min_tri_angle", "16", Tuning),
    int("Mapper.init_max_reg_trials", "2", Tuning),
    real("Mapper.abs_pose_max_error", "12", Used),
    int("Mapper.abs_pose_min_num_inliers", "30", Used),
    real("Mapper.abs_pose_min_inlier_ratio", "0.25", Used),
    real("Mapper.filter_max_reproj_error", "4", Used),
    real("Mapper.filter_min_tri_angle", "1.5", Used),
    int("Mapper.max_reg_trials", "3", Tuning),
    real("Mapper.local_ba_min_tri_angle", "6", Tuning),
    int("Mapper.tri_max_transitivity", "1", Tuning),
    real("Mapper.tri_create_max_angle_error", "2", Tuning),
    real("Mapper.tri_continue_max_angle_error", "2", Tuning),
    real("Mapper.tri_merge_max_reproj_error", "4", Used),
    real("Mapper.tri_complete_max_reproj_error", "4", Tuning),
    int("Mapper.tri_complete_max_transitivity", "5", Used),
    real("Mapper.tri_re_max_angle_error", "5", Tuning),
    real("Mapper.tri_re_min_ratio", "0.2", Tuning),
    int("Mapper.tri_re_max_trials", "1", Tuning),
    real("Mapper.tri_min_angle", "1.5", Used),
    bool("Mapper.tri_ignore_two_view_tracks", "1", Used),
];

/// Options of `point_triangulator` alone.
pub(super) const TRIANGULATOR: &[Spec] =
    &[bool("clear_points", "1", Used), bool("refine_intrinsics", "0", Used)];

/// Options of `bundle_adjuster`.
pub(super) const BUNDLE_ADJUSTMENT: &[Spec] = &[
    int("BundleAdjustment.max_num_iterations", "100", Used),
    int("BundleAdjustment.max_linear_solver_iterations", "200", Speed),
    real("BundleAdjustment.function_tolerance", "0", Used),
    real("BundleAdjustment.gradient_tolerance", "0", Tuning),
    real("BundleAdjustment.parameter_tolerance", "0", Tuning),
    bool("BundleAdjustment.refine_focal_length", "1", Used),
    bool("BundleAdjustment.refine_principal_point", "0", Used),
    bool("BundleAdjustment.refine_extra_params", "1", Used),
    bool("BundleAdjustment.refine_extrinsics", "1", Used),
    bool("BundleAdjustment.refine_sensor_from_rig", "1", Used),
    bool("BundleAdjustment.refine_points3D", "1", Fixed),
    bool("BundleAdjustment.constant_rig_from_world_rotation", "0", Fixed),
    int("BundleAdjustment.min_track_length", "0", Fixed),
    text("BundleAdjustment.backend", "CERES", Speed),
    bool("BundleAdjustment.use_gpu", "0", Speed),
    text("BundleAdjustment.gpu_index", "-1", Speed),
    text("BundleAdjustment.loss_function_type", "TRIVIAL", Fixed),
    real("BundleAdjustment.loss_function_scale", "1", Tuning),
    int("BundleAdjustment.num_threads", "-1", Speed),
];

/// Options of `automatic_reconstructor`.
pub(super) const AUTOMATIC: &[Spec] = &[
    path("workspace_path", "", Used),
    path("mask_path", "", Used),
    path("vocab_tree_path", "", Tuning),
    text("data_type", "individual", Used),
    text("quality", "high", Used),
    text("camera_model", "SIMPLE_RADIAL", Used),
    bool("single_camera", "0", Used),
    text("camera_params", "", Used),
    bool("sparse", "1", Fixed),
    bool("dense", "1", Used),
    text("mesher", "poisson", Tuning),
    int("num_threads", "-1", Speed),
    bool("use_gpu", "1", Speed),
    text("gpu_index", "-1", Speed),
];

/// Options of `model_orientation_aligner`.
pub(super) const ORIENTATION: &[Spec] =
    &[text("method", "MANHATTAN-WORLD", Used), int("max_image_size", "1024", Tuning)];

/// Options of `image_undistorter`.
pub(super) const UNDISTORTER: &[Spec] = &[
    text("output_type", "COLMAP", Used),
    text("copy_policy", "copy", Tuning),
    path("image_list_path", "", Fixed),
    int("num_patch_match_src_images", "20", Fixed),
    real("blank_pixels", "0", Used),
    real("min_scale", "0.2", Used),
    real("max_scale", "2", Used),
    int("max_image_size", "-1", Used),
    real("roi_min_x", "0", Fixed),
    real("roi_min_y", "0", Fixed),
    real("roi_max_x", "1", Fixed),
    real("roi_max_y", "1", Fixed),
    int("jpeg_quality", "-1", Tuning),
    int("num_threads", "-1", Speed),
];

/// Options of `patch_match_stereo` and `stereo_fusion`: where the images and maps are.
pub(super) const DENSE_WORKSPACE: &[Spec] = &[
    path("workspace_path", "", Used),
    text("workspace_format", "COLMAP", Fixed),
    // Names the lists of the format PMVS alone.
    text("pmvs_option_name", "option-all", Speed),
];

/// Options of `patch_match_stereo`.
pub(super) const PATCH_MATCH: &[Spec] = &[
    path("config_path", "", Used),
    int("PatchMatchStereo.max_image_size", "-1", Used),
    text("PatchMatchStereo.gpu_index", "-1", Speed),
    real("PatchMatchStereo.depth_min", "-1", Fixed),
    real("PatchMatchStereo.depth_max", "-1", Fixed),
    int("PatchMatchStereo.window_radius", "5", Tuning),
    int("PatchMatchStereo.window_step", "1", Tuning),
    real("PatchMatchStereo.sigma_spatial", "-1", Tuning),
    real("PatchMatchStereo.sigma_color", "0.2", Tuning),
    int("PatchMatchStereo.num_samples", "15", Tuning),
    real("PatchMatchStereo.ncc_sigma", "0.6", Tuning),
    real("PatchMatchStereo.min_triangulation_angle", "1", Tuning),
    real("PatchMatchStereo.incident_angle_sigma", "0.9", Tuning),
    int("PatchMatchStereo.num_iterations", "5", Tuning),
    bool("PatchMatchStereo.geom_consistency", "1", Used),
    real("PatchMatchStereo.geom_consistency_regularizer", "0.3", Tuning),
    real("PatchMatchStereo.geom_consistency_max_cost", "3", Tuning),
    bool("PatchMatchStereo.filter", "1", Fixed),
    real("PatchMatchStereo.filter_min_ncc", "0.1", Tuning),
    real("PatchMatchStereo.filter_min_triangulation_angle", "3", Tuning),
    int("PatchMatchStereo.filter_min_num_consistent", "2", Tuning),
    real("PatchMatchStereo.filter_geom_consistency_max_cost", "1", Tuning),
    real("PatchMatchStereo.cache_size", "32", Speed),
    bool("PatchMatchStereo.allow_missing_files", "0", Fixed),
    bool("PatchMatchStereo.write_consistency_graph", "0", Fixed),
    int("PatchMatchStereo.num_threads", "-1", Speed),
];

/// Options of `stereo_fusion`.
pub(super) const FUSION: &[Spec] = &[
    text("input_type", "geometric", Used),
    text("output_type", "PLY", Fixed),
    path("bbox_path", "", Used),
    path("StereoFusion.mask_path", "", Used),
    int("StereoFusion.num_threads", "-1", Speed),
    int("StereoFusion.max_image_size", "-1", Used),
    int("StereoFusion.min_num_pixels", "5", Used),
    int("StereoFusion.max_num_pixels", "10000", Tuning),
    int("StereoFusion.max_traversal_depth", "100", Tuning),
    real("StereoFusion.max_reproj_error", "2", Used),
    real("StereoFusion.max_depth_error", "0.01", Used),
    real("StereoFusion.max_normal_error", "10", Used),
    int("StereoFusion.check_num_images", "50", Tuning),
    real("StereoFusion.cache_size", "32", Speed),
    bool("StereoFusion.use_cache", "0", Speed),
    OVERWRITE,
];

/// Replaces a named file, whoever made it. COLMAP has no such option, and replaces any file.
const OVERWRITE: Spec = bool("overwrite", "0", Used);

/// Options of `model_converter`.
pub(super) const CONVERTER: &[Spec] =
    &[text("output_type", "", Used), bool("skip_distortion", "0", Tuning), OVERWRITE];

/// Options of `model_aligner`.
pub(super) const ALIGNER: &[Spec] = &[
    path("ref_images_path", "", Used),
    bool("ref_is_gps", "1", Used),
    path("ref_model_path", "", Fixed),
    bool("merge_image_and_ref_origins", "0", Fixed),
    path("transform_path", "", Used),
    OVERWRITE,
    text("alignment_type", "custom", Used),
    int("min_common_images", "3", Used),
    real("min_inlier_observations", "0.3", Tuning),
    real("max_reproj_error", "8", Tuning),
    bool("estimate_scale", "1", Fixed),
    bool("robust_alignment", "1", Used),
    real("robust_alignment_max_error", "0", Used),
];

/// Options of `model_analyzer`.
pub(super) const ANALYZER: &[Spec] = &[path("path", "", Used), bool("verbose", "0", Speed)];

/// Options of `model_merger`.
pub(super) const MERGER: &[Spec] = &[
    path("input_path1", "", Used),
    path("input_path2", "", Used),
    real("max_reproj_error", "64", Used),
];

/// Options of `rig_configurator`.
pub(super) const RIGS: &[Spec] = &[path("rig_config_path", "", Used)];

/// Names of COLMAP 4 and, behind them, of COLMAP 3.
pub(super) const ALIASES: &[(&str, &str)] = &[
    ("FeatureExtraction.num_threads", "SiftExtraction.num_threads"),
    ("FeatureExtraction.use_gpu", "SiftExtraction.use_gpu"),
    ("FeatureExtraction.gpu_index", "SiftExtraction.gpu_index"),
    ("FeatureExtraction.max_image_size", "SiftExtraction.max_image_size"),
    ("FeatureMatching.num_threads", "SiftMatching.num_threads"),
    ("FeatureMatching.use_gpu", "SiftMatching.use_gpu"),
    ("FeatureMatching.gpu_index", "SiftMatching.gpu_index"),
    ("FeatureMatching.guided_matching", "SiftMatching.guided_matching"),
    ("FeatureMatching.max_num_matches", "SiftMatching.max_num_matches"),
    ("TwoViewGeometry.max_error", "SiftMatching.max_error"),
    ("TwoViewGeometry.confidence", "SiftMatching.confidence"),
    ("TwoViewGeometry.max_num_trials", "SiftMatching.max_num_trials"),
    ("TwoViewGeometry.min_inlier_ratio", "SiftMatching.min_inlier_ratio"),
    ("TwoViewGeometry.min_num_inliers", "SiftMatching.min_num_inliers"),
    ("TwoViewGeometry.multiple_models", "SiftMatching.multiple_models"),
    ("TwoViewGeometry.compute_relative_pose", "SiftMatching.compute_relative_pose"),
    ("BundleAdjustmentCeres.max_num_iterations", "BundleAdjustment.max_num_iterations"),
    (
        "BundleAdjustmentCeres.max_linear_solver_iterations",
        "BundleAdjustment.max_linear_solver_iterations",
    ),
    ("BundleAdjustmentCeres.function_tolerance", "BundleAdjustment.function_tolerance"),
    ("BundleAdjustmentCeres.gradient_tolerance", "BundleAdjustment.gradient_tolerance"),
    ("BundleAdjustmentCeres.parameter_tolerance", "BundleAdjustment.parameter_tolerance"),
    ("BundleAdjustmentCeres.use_gpu", "BundleAdjustment.use_gpu"),
    ("BundleAdjustmentCeres.gpu_index", "BundleAdjustment.gpu_index"),
    ("BundleAdjustmentCeres.loss_function_type", "BundleAdjustment.loss_function_type"),
    ("BundleAdjustmentCeres.loss_function_scale", "BundleAdjustment.loss_function_scale"),
    ("Mapper.ba_global_frames_ratio", "Mapper.ba_global_images_ratio"),
    ("Mapper.ba_global_frames_freq", "Mapper.ba_global_images_freq"),
    ("Mapper.snapshot_frames_freq", "Mapper.snapshot_images_freq"),
    ("Mapper.fix_existing_frames", "Mapper.fix_existing_images"),
    (
        "Mapper.ba_min_num_residuals_for_cpu_multi_threading",
        "Mapper.ba_min_num_residuals_for_multi_threading",
    ),
    ("Mapper.ba_local_min_tri_angle", "Mapper.local_ba_min_tri_angle"),
    ("BundleAdjustment.refine_rig_from_world", "BundleAdjustment.refine_extrinsics"),
    ("alignment_max_error", "robust_alignment_max_error"),
];
