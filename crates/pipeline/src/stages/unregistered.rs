//! Why images have no pose in the largest model, and which images nearly connect the models.

use tiepoint_sfm::diagnostics;
use tiepoint_sfm::scene::{CorrespondenceGraph, ImageId, Reconstruction};
use tiepoint_sfm::{MappedModel, MapperOptions};

use crate::workspace::file_names::model_path;
use crate::workspace::unregistered::{NearestImage, UnregisteredImage};
use crate::workspace::warning::ModelGap;

/// The images without a pose in the first of `models`.
pub(crate) fn unregistered_images(
    graph: &CorrespondenceGraph,
    models: &[MappedModel],
    options: &MapperOptions,
) -> Vec<UnregisteredImage> {
    let models: Vec<&Reconstruction> = models.iter().map(|model| &model.reconstruction).collect();
    let found = diagnostics::unregistered_images(graph, &models, &options.register, options.seed);
    let name = |image: ImageId| models[0].image(image).name.clone();
    let described = found.into_iter().map(|found| UnregisteredImage {
        image: name(found.image),
        posed_in: found.posed_in.map(model_path),
        model: model_path(found.model),
        reason: found.reason.into(),
        nearest: found.nearest.map(|(image, matches)| NearestImage { image: name(image), matches }),
    });
    described.collect()
}

/// For each model but the first the pair that comes closest to connecting it with a larger one.
/// Matches between two places that look alike connect nothing.
pub(crate) fn gaps(graph: &CorrespondenceGraph, models: &[MappedModel]) -> Vec<ModelGap> {
    let gap = |(index, mapped): (usize, &MappedModel)| {
        let model = &mapped.reconstruction;
        let larger = models[..index].iter().enumerate();
        let larger = larger.filter(|(_, larger)| !larger.is_other_place_than(mapped));
        let found = larger.rev().filter_map(|(other, larger)| {
            let pair = diagnostics::nearest_pair(graph, &larger.reconstruction, model)?;
            Some((other, pair))
        });
        let best = found.max_by_key(|(_, (_, matches))| *matches);
        let name = |image: ImageId| model.image(image).name.clone();
        ModelGap {
            model: model_path(index),
            nearest: best.map(|(other, _)| model_path(other)),
            images: best.map(|(_, (images, _))| images.map(name)),
            matches: best.map_or(0, |(_, (_, matches))| matches),
        }
    };
    models.iter().enumerate().skip(1).map(gap).collect()
}
