//! Columns with units: the field of a row, its unit and its meaning.
//!
//! A column has its dimension as a type, so that a length in seconds is an error of the descriptor and not of the estimate.

use std::f64::consts::PI;
use std::fmt;
use std::marker::PhantomData;

use serde::Deserialize;
use serde::de::{Deserializer, Error, MapAccess, Visitor};

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct FiniteNumber(pub(super) f64);

impl<'de> Deserialize<'de> for FiniteNumber {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = f64::deserialize(deserializer)?;
        if value.is_finite() { Ok(Self(value)) } else { Err(Error::custom("the number must be finite")) }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum ColumnRef {
    /// From 0.
    Index(usize),
    Name(String),
}

impl fmt::Display for ColumnRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Index(index) => write!(f, "{index}"),
            Self::Name(name) => f.write_str(name),
        }
    }
}

struct ColumnRefVisitor;

impl Visitor<'_> for ColumnRefVisitor {
    type Value = ColumnRef;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a column: its number from 0, or its name in the header line")
    }
    fn visit_i64<E: Error>(self, index: i64) -> Result<ColumnRef, E> {
        let index = usize::try_from(index)
            .map_err(|error| E::custom(format!("column {index}, but columns count from 0: {error}")))?;
        Ok(ColumnRef::Index(index))
    }
    fn visit_str<E: Error>(self, name: &str) -> Result<ColumnRef, E> {
        Ok(ColumnRef::Name(name.to_owned()))
    }
}

impl<'de> Deserialize<'de> for ColumnRef {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ColumnRefVisitor)
    }
}

/// A unit of a dimension: `SI value = (raw + zero) * factor`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Unit {
    pub(super) name: &'static str,
    pub(super) factor: f64,
    pub(super) zero: f64,
}

const fn unit(name: &'static str, factor: f64) -> Unit {
    let zero = 0.0;
    Unit { name, factor, zero }
}

const DEGREE: f64 = PI / 180.0;
/// Standard gravity, in m/s² (by definition of the CGPM, 1901).
const STANDARD_GRAVITY: f64 = 9.80665;
/// 0 °C in kelvin (by definition).
const ICE_POINT: f64 = 273.15;

pub(super) trait Dimension: Clone {
    const NAME: &'static str;
    /// The first is the default.
    const UNITS: &'static [Unit];
    /// Whether the descriptor must name the unit.
    const NEEDS_UNIT: bool = false;
}

macro_rules! dimension {
    ($name:ident, $text:literal, $needs:literal, $($unit:expr),+) => {
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub(super) enum $name {}
        impl Dimension for $name {
            const NAME: &'static str = $text;
            const UNITS: &'static [Unit] = &[$($unit),+];
            const NEEDS_UNIT: bool = $needs;
        }
    };
}

dimension!(Length, "length", false, unit("m", 1.0), unit("mm", 1e-3), unit("cm", 1e-2));
dimension!(Angle, "angle", false, unit("rad", 1.0), unit("deg", DEGREE));
dimension!(Speed, "speed", false, unit("m_per_s", 1.0), unit("mm_per_s", 1e-3));
dimension!(TurnRate, "turn rate", false, unit("rad_per_s", 1.0), unit("deg_per_s", DEGREE));
dimension!(
    Acceleration,
    "acceleration",
    false,
    unit("m_per_s2", 1.0),
    unit("mm_per_s2", 1e-3),
    unit("g", STANDARD_GRAVITY)
);
dimension!(
    Temperature,
    "temperature",
    false,
    unit("celsius", 1.0),
    Unit { name: "kelvin", factor: 1.0, zero: -ICE_POINT }
);
dimension!(AngleVariance, "variance of an angle", false, unit("rad2", 1.0), unit("deg2", DEGREE * DEGREE));
dimension!(Area, "variance", false, unit("m2", 1.0), unit("mm2", 1e-6));
// Ticks and lengths become radians through the robot's geometry; their factors here are within their own kind.
dimension!(
    WheelTurn,
    "wheel rotation",
    true,
    unit("ticks", 1.0),
    unit("m", 1.0),
    unit("mm", 1e-3),
    unit("rad", 1.0),
    unit("deg", DEGREE)
);
dimension!(Id, "number", false, unit("none", 1.0));

/// A column of the dimension `D`: `SI value = (raw * scale + offset + zero) * factor`, with `offset` in the unit.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Column<D> {
    pub(super) source: ColumnRef,
    pub(super) unit: Unit,
    pub(super) scale: f64,
    pub(super) offset: f64,
    dimension: PhantomData<D>,
}

impl<D> Column<D> {
    pub(super) fn to_si(&self, raw: f64) -> f64 {
        (raw * self.scale + self.offset + self.unit.zero) * self.unit.factor
    }
}

/// The keys of a column in table form.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawColumn {
    column: ColumnRef,
    unit: Option<String>,
    scale: Option<FiniteNumber>,
    offset: Option<FiniteNumber>,
}

struct ColumnVisitor<D>(PhantomData<D>);

impl<D: Dimension> ColumnVisitor<D> {
    fn build<E: Error>(raw: RawColumn) -> Result<Column<D>, E> {
        let known = || {
            let names: Vec<_> = D::UNITS.iter().map(|unit| unit.name).collect();
            names.join(", ")
        };
        let unit = match raw.unit {
            None if D::NEEDS_UNIT => {
                let name = D::NAME;
                let text = format!("a {name} needs `unit`, one of: {}", known());
                return Err(E::custom(text));
            }
            None => D::UNITS.first(),
            Some(ref name) => D::UNITS.iter().find(|unit| unit.name == name),
        };
        let Some(unit) = unit else {
            let (requested, name) = (raw.unit.unwrap_or_default(), D::NAME);
            let text = format!("`{requested}` is not a unit of {name}: use one of: {}", known());
            return Err(E::custom(text));
        };
        Ok(Column {
            source: raw.column,
            unit: *unit,
            scale: raw.scale.map_or(1.0, |scale| scale.0),
            offset: raw.offset.map_or(0.0, |offset| offset.0),
            dimension: PhantomData,
        })
    }

    fn plain<E: Error>(column: ColumnRef) -> Result<Column<D>, E> {
        Self::build(RawColumn { column, unit: None, scale: None, offset: None })
    }
}

impl<'de, D: Dimension> Visitor<'de> for ColumnVisitor<D> {
    type Value = Column<D>;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a column: number, name, or { column, unit, scale, offset }")
    }
    fn visit_i64<E: Error>(self, index: i64) -> Result<Column<D>, E> {
        Self::plain(ColumnRefVisitor.visit_i64(index)?)
    }
    fn visit_str<E: Error>(self, name: &str) -> Result<Column<D>, E> {
        Self::plain(ColumnRefVisitor.visit_str(name)?)
    }
    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Column<D>, A::Error> {
        let raw = RawColumn::deserialize(serde::de::value::MapAccessDeserializer::new(map))?;
        Self::build(raw)
    }
}

impl<'de, D: Dimension> Deserialize<'de> for Column<D> {
    fn deserialize<De: Deserializer<'de>>(deserializer: De) -> Result<Self, De::Error> {
        deserializer.deserialize_any(ColumnVisitor(PhantomData))
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum HeadingColumns {
    Angle(Column<Angle>),
    /// A quaternion that turns about the vertical only.
    Quaternion {
        qz: ColumnRef,
        qw: ColumnRef,
    },
}

/// The keys of a heading in table form; their combination is checked later.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawHeading {
    column: Option<ColumnRef>,
    unit: Option<String>,
    scale: Option<FiniteNumber>,
    offset: Option<FiniteNumber>,
    qz: Option<ColumnRef>,
    qw: Option<ColumnRef>,
}

struct HeadingVisitor;

impl<'de> Visitor<'de> for HeadingVisitor {
    type Value = HeadingColumns;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a column: number, name, { column, unit, scale, offset } or { qz, qw }")
    }
    fn visit_i64<E: Error>(self, index: i64) -> Result<HeadingColumns, E> {
        let column = ColumnVisitor(PhantomData).visit_i64(index)?;
        Ok(HeadingColumns::Angle(column))
    }
    fn visit_str<E: Error>(self, name: &str) -> Result<HeadingColumns, E> {
        let column = ColumnVisitor(PhantomData).visit_str(name)?;
        Ok(HeadingColumns::Angle(column))
    }
    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<HeadingColumns, A::Error> {
        let raw = RawHeading::deserialize(serde::de::value::MapAccessDeserializer::new(map))?;
        match raw {
            RawHeading { column: Some(column), unit, scale, offset, qz: None, qw: None } => {
                ColumnVisitor::build(RawColumn { column, unit, scale, offset }).map(HeadingColumns::Angle)
            }
            RawHeading { column: None, unit: None, scale: None, offset: None, qz: Some(qz), qw: Some(qw) } => {
                Ok(HeadingColumns::Quaternion { qz, qw })
            }
            RawHeading { .. } => {
                Err(Error::custom("a heading is either { column, unit, scale, offset } or { qz, qw }"))
            }
        }
    }
}

impl<'de> Deserialize<'de> for HeadingColumns {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(HeadingVisitor)
    }
}
