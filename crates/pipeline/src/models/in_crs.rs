//! The coordinates of a georeferenced model in a coordinate reference system, for exports.

use std::path::Path;

use tiepoint_io::ply::Vertex;
use tiepoint_sfm::geometry::crs::Crs;
use tiepoint_sfm::geometry::geodesy::{Geodetic, LocalFrame, UtmZone};
use tiepoint_sfm::geometry::nalgebra::Vector3;
use tiepoint_sfm::scene::{Georeference, Place};

use crate::Error;
use crate::workspace::located_model::LocatedModel;

/// The frame of a model, and the system that its coordinates are wanted in.
#[derive(Clone, Copy, Debug)]
pub(super) struct InCrs<'a> {
    pub(super) crs: Crs,
    frame: &'a LocalFrame,
    /// Whether heights above the ellipsoid are known; else they are above the model's origin.
    pub(super) has_heights: bool,
    model: &'a Path,
}

impl<'a> InCrs<'a> {
    /// # Errors
    ///
    /// Nothing tells where on the earth the model is, or how high, where the system needs that.
    pub(super) fn new(located: &'a LocatedModel, crs: Crs) -> Result<Self, Error> {
        let model = located.folder();
        let Some(Georeference::Enu { frame, has_height }) = &located.reconstruction.georeference
        else {
            return Err(Error::NoPlace { model: model.to_owned() });
        };
        if crs.needs_height() && !has_height {
            return Err(Error::NoHeights { model: model.to_owned(), crs });
        }
        Ok(Self { crs, frame, has_heights: *has_height, model })
    }

    fn place(&self, local: &Vector3<f64>) -> Result<Geodetic, Error> {
        let place = self.frame.to_geodetic(local);
        match self.crs.contains(&place) {
            true => Ok(place),
            false => Err(Error::OutsideCrs {
                model: self.model.to_owned(),
                crs: self.crs,
                zone: Crs::Utm { zone: UtmZone::of(&place), is_etrs89: false },
                latitude_deg: place.latitude_deg,
                longitude_deg: place.longitude_deg,
            }),
        }
    }

    /// A cloud of the model.
    ///
    /// # Errors
    ///
    /// A point is far outside of the area of the system.
    pub(super) fn vertices(&self, mut vertices: Vec<Vertex>) -> Result<Vec<Vertex>, Error> {
        for vertex in &mut vertices {
            vertex.xyz = self.crs.project(&self.place(&vertex.xyz)?);
        }
        Ok(vertices)
    }

    /// The coordinates of a point of the model, as files of positions have them.
    ///
    /// # Errors
    ///
    /// It is far outside of the area of the system.
    pub(super) fn coordinates(&self, local: &Vector3<f64>) -> Result<Place, Error> {
        let place = self.place(local)?;
        let Geodetic { latitude_deg, longitude_deg, height_m } = place;
        let altitude_m = self.has_heights.then_some(height_m);
        Ok(match self.crs {
            Crs::Geographic { .. } => Place::Geodetic { latitude_deg, longitude_deg, altitude_m },
            Crs::Geocentric | Crs::Utm { .. } => Place::Cartesian(self.crs.project(&place)),
        })
    }
}
