//! The keys of a descriptor for serde; docs/recordings.md explains each.
//!
//! Only types are checked here; `descriptor` validates the values.

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

use crate::csv_dialect::{DecimalMark, Delimiter};
use crate::ros2::bag::BagTopic;

use super::column::{
    Acceleration, Angle, AngleVariance, Area, Column, ColumnRef, FiniteNumber, HeadingColumns, Id, Length, Speed,
    Temperature, TurnRate, WheelTurn,
};

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawDescriptor {
    pub(super) name: String,
    pub(super) source: String,
    pub(super) licence: String,
    pub(super) default_run: Spanned<String>,
    #[serde(default)]
    pub(super) robot: toml::Table,
    #[serde(default)]
    pub(super) filter: toml::Table,
    pub(super) start: Option<Spanned<RawStart>>,
    pub(super) runs: Vec<Spanned<RawRun>>,
    pub(super) files: BTreeMap<String, FileEntry>,
    pub(super) landmarks: Option<PointMap>,
    pub(super) beacons: Option<PointMap>,
    #[serde(default)]
    pub(super) wheels: Vec<Wheels>,
    #[serde(default)]
    pub(super) odometer: Vec<Odometer>,
    #[serde(default)]
    pub(super) body_velocity: Vec<BodyVelocity>,
    #[serde(default)]
    pub(super) gyro: Vec<Gyro>,
    #[serde(default)]
    pub(super) accelerometers: Vec<Accelerometers>,
    #[serde(default)]
    pub(super) landmark_sightings: Vec<LandmarkSightings>,
    #[serde(default)]
    pub(super) beacon_ranges: Vec<BeaconRanges>,
    #[serde(default)]
    pub(super) wall_range: Vec<WallRange>,
    #[serde(default)]
    pub(super) compass: Vec<Compass>,
    #[serde(default)]
    pub(super) temperature: Vec<Thermometer>,
    #[serde(default)]
    pub(super) fixes: Vec<Fixes>,
    #[serde(default)]
    pub(super) truth: Vec<Truth>,
}

/// `[start]`, or a run's own `start`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawStart {
    pub(super) from: Option<StartSource>,
    pub(super) x_m: Option<FiniteNumber>,
    pub(super) y_m: Option<FiniteNumber>,
    pub(super) heading_rad: Option<FiniteNumber>,
    pub(super) heading_deg: Option<FiniteNumber>,
    pub(super) position_sigma_m: FiniteNumber,
    pub(super) heading_sigma_rad: FiniteNumber,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum StartSource {
    Truth,
    /// A fix, used or withheld.
    Fixes,
}

/// An entry of `[[runs]]`: one run, or a group of runs that differ in one text.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawRun {
    pub(super) name: String,
    pub(super) each: Option<Vec<String>>,
    #[serde(default)]
    pub(super) values: BTreeMap<String, String>,
    #[serde(default)]
    pub(super) robot: toml::Table,
    pub(super) start: Option<Spanned<RawStart>>,
    pub(super) tag: Option<TagPosition>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TagPosition {
    pub(super) x_m: FiniteNumber,
    pub(super) y_m: FiniteNumber,
}

/// A `[files.*]` table: a file and its format.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FileEntry {
    pub(super) path: Spanned<String>,
    /// Of a ROS 2 bag; the other keys then have the defaults of [`FileEntry::fill_topic_defaults`].
    pub(super) topic: Option<String>,
    /// Names of the joints of the left and the right wheel, in messages of joints.
    pub(super) joints: Option<[String; 2]>,
    /// Direction of the range that is taken of a scan.
    pub(super) bearing_deg: Option<FiniteNumber>,
    /// `None` detects it.
    pub(super) delimiter: Option<Delimiter>,
    pub(super) decimal: Option<DecimalMark>,
    #[serde(default)]
    pub(super) header_lines: usize,
    pub(super) comment: Option<String>,
    pub(super) filter: Option<RowFilter>,
    pub(super) time: Option<TimeColumn>,
    pub(super) arrival: Option<TimeColumn>,
    pub(super) offset_s: Option<FiniteNumber>,
    pub(super) max_gap_s: Option<FiniteNumber>,
    #[serde(default)]
    pub(super) order: RowOrder,
}

impl FileEntry {
    /// The table that a topic becomes has a header with names, and the times of each message.
    pub(super) fn fill_topic_defaults(&mut self) {
        if self.topic.is_none() {
            return;
        }
        let nanos =
            |name: &str| TimeColumn { column: ColumnRef::Name(name.to_owned()), unit: TimeUnit::Ns, plus: None };
        self.header_lines = 1;
        self.delimiter.get_or_insert(Delimiter::Comma);
        self.decimal.get_or_insert(DecimalMark::Point);
        self.time.get_or_insert_with(|| nanos("stamp_ns"));
        self.arrival.get_or_insert_with(|| nanos("log_ns"));
    }

    /// The topic to read of a bag, if this is one.
    pub(super) fn bag_topic(&self) -> Option<BagTopic> {
        Some(BagTopic {
            name: self.topic.clone()?,
            joints: self.joints.clone(),
            bearing_rad: self.bearing_deg.unwrap_or_default().0.to_radians(),
        })
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum RowOrder {
    /// As in the file; a decreasing timestamp is a bad row.
    #[default]
    File,
    /// By timestamp, for files whose blocks were written out of order.
    Time,
}

/// Keeps only rows with this text in this column.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RowFilter {
    pub(super) column: ColumnRef,
    pub(super) equals: String,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TimeColumn {
    pub(super) column: ColumnRef,
    #[serde(default)]
    pub(super) unit: TimeUnit,
    /// A second column to add, as in seconds and nanoseconds.
    pub(super) plus: Option<TimePart>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TimePart {
    pub(super) column: ColumnRef,
    pub(super) unit: TimeUnit,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum TimeUnit {
    #[default]
    S,
    Ms,
    Us,
    Ns,
}

impl TimeUnit {
    /// Power of ten of the unit, in seconds.
    pub(super) const fn exponent(self) -> i32 {
        match self {
            Self::S => 0,
            Self::Ms => -3,
            Self::Us => -6,
            Self::Ns => -9,
        }
    }
}

/// `[landmarks]` or `[beacons]`: known points in the arena.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PointMap {
    pub(super) file: Spanned<String>,
    /// `None` numbers the rows from 0.
    pub(super) id: Option<Column<Id>>,
    pub(super) x: Column<Length>,
    pub(super) y: Column<Length>,
}

/// A table of two columns that maps the ids of a file to those of a map.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct IdMap {
    pub(super) file: Spanned<String>,
    pub(super) from: Column<Id>,
    pub(super) to: Column<Id>,
}

/// Meaning of a counter: total, or increment since the previous row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Counting {
    Absolute,
    /// Those of the first row are not used.
    Increments,
}

/// The interval for which a row's speeds hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum SpeedInterval {
    /// Until the timestamp of the next row, as for a command.
    #[default]
    Next,
    /// From the timestamp of the previous row, as for a mean.
    Previous,
}

/// Common keys of all streams: file, runs, sensor and timestamps.
#[derive(Clone, Debug)]
pub(super) struct StreamOptions<'a> {
    pub(super) file: &'a Spanned<String>,
    pub(super) runs: Option<&'a [String]>,
    pub(super) sensor: Option<u8>,
    pub(super) stamp_shift_s: f64,
    pub(super) stamp_sigma_s: f64,
}

impl StreamOptions<'_> {
    pub(super) fn is_in(&self, run: &str) -> bool {
        self.runs.is_none_or(|prefixes| prefixes.iter().any(|prefix| run.starts_with(prefix.as_str())))
    }
}

pub(super) trait Stream {
    const KEY: &'static str;
    fn common(&self) -> StreamOptions<'_>;
    fn column_refs(&self) -> Vec<&ColumnRef>;
    /// Contradictions between its keys.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}

trait HasColumnRefs {
    fn column_refs(&self) -> Vec<&ColumnRef>;
}

impl<D> HasColumnRefs for Column<D> {
    fn column_refs(&self) -> Vec<&ColumnRef> {
        vec![&self.source]
    }
}

impl HasColumnRefs for HeadingColumns {
    fn column_refs(&self) -> Vec<&ColumnRef> {
        match self {
            Self::Angle(column) => vec![&column.source],
            Self::Quaternion { qz, qw } => vec![qz, qw],
        }
    }
}

impl<T: HasColumnRefs> HasColumnRefs for Option<T> {
    fn column_refs(&self) -> Vec<&ColumnRef> {
        self.iter().flat_map(T::column_refs).collect()
    }
}

/// Declares a kind of stream: its key, columns, and other keys.
macro_rules! stream {
    (
        $(#[$doc:meta])* $name:ident, $key:literal,
        columns { $($column:ident: $column_type:ty,)+ }
        keys { $($(#[$attr:meta])* $field:ident: $type:ty,)* }
        $(check($this:ident) $check:block)?
    ) => {
        $(#[$doc])*
        #[derive(Clone, Debug, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub(super) struct $name {
            file: Spanned<String>,
            runs: Option<Vec<String>>,
            sensor: Option<u8>,
            stamp_shift_s: Option<FiniteNumber>,
            stamp_sigma_s: Option<FiniteNumber>,
            $(pub(super) $column: $column_type,)+
            $($(#[$attr])* pub(super) $field: $type,)*
        }

        impl Stream for $name {
            const KEY: &'static str = $key;
            fn common(&self) -> StreamOptions<'_> {
                StreamOptions {
                    file: &self.file,
                    runs: self.runs.as_deref(),
                    sensor: self.sensor,
                    stamp_shift_s: self.stamp_shift_s.unwrap_or_default().0,
                    stamp_sigma_s: self.stamp_sigma_s.unwrap_or_default().0,
                }
            }
            fn column_refs(&self) -> Vec<&ColumnRef> {
                [$(self.$column.column_refs()),+].concat()
            }
            $(fn check(&self) -> Result<(), String> {
                let $this = self;
                $check
            })?
        }
    };
}

/// All of `one` and none of `other` must be given, or the reverse.
fn require_either(one: &[bool], other: &[bool], otherwise: &str) -> Result<(), String> {
    let are_all = |given: &[bool], wanted: bool| given.iter().all(|given| *given == wanted);
    let fits = are_all(one, true) && are_all(other, false) || are_all(one, false) && are_all(other, true);
    fits.then_some(()).ok_or_else(|| otherwise.to_owned())
}

stream! {
    /// `[[wheels]]`: counts of both wheels.
    Wheels, "wheels",
    columns { left: Column<WheelTurn>, right: Column<WheelTurn>, }
    keys { counting: Counting, wrap_bits: Option<u32>, max_wheel_rad_per_s: Option<FiniteNumber>, }
    check(this) {
        let Some(bits) = this.wrap_bits else { return Ok(()) };
        let fits = (8..=32).contains(&bits)
            && this.counting == Counting::Absolute
            && this.left.unit.name == "ticks"
            && this.right.unit.name == "ticks";
        fits.then_some(()).ok_or_else(|| "wrap_bits is 8 to 32 and goes with absolute ticks only".to_owned())
    }
}

stream! {
    /// `[[odometer]]`: an integrated pose of a foreign odometer, or its increments.
    Odometer, "odometer",
    columns {
        x: Option<Column<Length>>, y: Option<Column<Length>>, heading: Option<HeadingColumns>,
        distance: Option<Column<Length>>, turn: Option<Column<Angle>>,
    }
    keys { max_speed_m_per_s: Option<FiniteNumber>, }
    check(this) {
        let pose = [this.x.is_some(), this.y.is_some(), this.heading.is_some()];
        let steps = [this.distance.is_some(), this.turn.is_some()];
        require_either(&pose, &steps, "an odometer is either x, y and heading, or distance and turn")
    }
}

stream! {
    /// `[[body_velocity]]`: forward and turn speed, or the speeds of both wheels.
    BodyVelocity, "body_velocity",
    columns {
        forward: Option<Column<Speed>>, turn: Option<Column<TurnRate>>,
        left: Option<Column<Speed>>, right: Option<Column<Speed>>,
    }
    keys { #[serde(default)] interval: SpeedInterval, }
    check(this) {
        let body = [this.forward.is_some(), this.turn.is_some()];
        let wheels = [this.left.is_some(), this.right.is_some()];
        require_either(&body, &wheels, "a body velocity is either forward and turn, or left and right")
    }
}

stream! {
    /// `[[gyro]]`: the turn rate about the vertical.
    Gyro, "gyro",
    columns { turn_rate: Column<TurnRate>, }
    keys { #[serde(default)] only_changes: bool, }
}

stream! {
    /// `[[accelerometers]]`: forward acceleration at both wheels.
    Accelerometers, "accelerometers",
    columns { left: Column<Acceleration>, right: Column<Acceleration>, }
    keys {}
}

stream! {
    /// `[[landmark_sightings]]`: range and bearing to known landmarks.
    LandmarkSightings, "landmark_sightings",
    columns { id: Column<Id>, range: Column<Length>, bearing: Column<Angle>, }
    keys {
        ids: Option<IdMap>, #[serde(default)] ignore: Vec<u32>,
        min_m: Option<FiniteNumber>, max_m: Option<FiniteNumber>,
    }
}

stream! {
    /// `[[beacon_ranges]]`: ranges to known radio beacons.
    BeaconRanges, "beacon_ranges",
    columns { id: Column<Id>, range: Column<Length>, }
    keys { min_m: Option<FiniteNumber>, max_m: Option<FiniteNumber>, }
}

stream! {
    /// `[[wall_range]]`: range straight ahead.
    WallRange, "wall_range",
    columns { range: Column<Length>, }
    keys {
        #[serde(default)] only_changes: bool, min_m: Option<FiniteNumber>, max_m: Option<FiniteNumber>,
    }
}

stream! {
    /// `[[compass]]`: heading in the arena.
    Compass, "compass",
    columns { heading: HeadingColumns, }
    keys { #[serde(default)] only_changes: bool, }
}

stream! {
    Thermometer, "temperature",
    columns { temperature: Column<Temperature>, }
    keys { #[serde(default)] only_changes: bool, }
}

stream! {
    /// `[[fixes]]`: positions or poses in the arena from an external sensor.
    Fixes, "fixes",
    columns {
        x: Option<Column<Length>>, y: Option<Column<Length>>,
        latitude: Option<Column<Angle>>, longitude: Option<Column<Angle>>,
        heading: Option<HeadingColumns>,
        variance_x: Option<Column<Area>>, variance_y: Option<Column<Area>>,
        variance_heading: Option<Column<AngleVariance>>,
    }
    keys {
        origin: Option<Origin>,
        tag: Option<TagPosition>,
        position_sigma_m: Option<FiniteNumber>,
        heading_sigma_rad: Option<FiniteNumber>,
        use_every: Option<usize>,
        use_first: Option<usize>,
        max_speed_m_per_s: Option<FiniteNumber>,
    }
    check(this) {
        let plane = [this.x.is_some(), this.y.is_some()];
        let earth = [this.latitude.is_some(), this.longitude.is_some(), this.origin.is_some()];
        require_either(&plane, &earth, "a fix is either x and y, or latitude and longitude with an `origin`")?;
        let variances = [this.variance_x.is_some(), this.variance_y.is_some()];
        let has_position = match (this.position_sigma_m, variances) {
            (Some(_), [false, false]) | (None, [true, true]) => Some(true),
            (None, [false, false]) => Some(false),
            (_, [_, _]) => None,
        };
        let heading = this.heading_sigma_rad.is_some() || this.variance_heading.is_some();
        let is_twice = this.heading_sigma_rad.is_some() && this.variance_heading.is_some();
        let fits = !is_twice && match (has_position, heading) {
            (None, _) => false,
            (Some(position), true) => position && this.heading.is_some(),
            (Some(true), false) => this.heading.is_none(),
            (Some(false), false) => true,
        };
        let otherwise = "fixes of a position take position_sigma_m or variance_x and variance_y, fixes of a pose also \
            heading_sigma_rad or variance_heading, or neither";
        fits.then_some(()).ok_or_else(|| otherwise.to_owned())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Origin {
    pub(super) latitude_deg: FiniteNumber,
    pub(super) longitude_deg: FiniteNumber,
}

stream! {
    /// `[[truth]]`: true poses; for scoring only.
    Truth, "truth",
    columns { x: Column<Length>, y: Column<Length>, heading: Option<HeadingColumns>, }
    keys { max_speed_m_per_s: Option<FiniteNumber>, }
}

impl PointMap {
    pub(super) fn column_refs(&self) -> Vec<&ColumnRef> {
        [self.id.column_refs(), self.x.column_refs(), self.y.column_refs()].concat()
    }
}

impl IdMap {
    pub(super) fn column_refs(&self) -> Vec<&ColumnRef> {
        vec![&self.from.source, &self.to.source]
    }
}
