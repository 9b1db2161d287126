//! The headers of the streams: names with units.

/// The filter's estimate. The covariance is the upper triangle over x, y, heading, forward and turn.
pub(super) const ESTIMATES: &str = "t_s,x_m,y_m,heading_rad,forward_m_per_s,turn_rad_per_s,\
    var_x_m2,cov_x_y_m2,cov_x_heading_m_rad,cov_x_forward_m2_per_s,cov_x_turn_m_rad_per_s,\
    var_y_m2,cov_y_heading_m_rad,cov_y_forward_m2_per_s,cov_y_turn_m_rad_per_s,\
    var_heading_rad2,cov_heading_forward_m_rad_per_s,cov_heading_turn_rad2_per_s,\
    var_forward_m2_per_s2,cov_forward_turn_m_rad_per_s2,var_turn_rad2_per_s2,\
    position_valid,heading_valid,speeds_valid,dead_reckoning,fix_age_s,reset_counter,host_s";

/// What became of each observation. Innovation and S are in the SI units of the observation's kind.
pub(super) const FUSION: &str = "t_s,sensor,sensor_name,kind,verdict,lag_s,degrees_of_freedom,nis,log_likelihood,\
    innovation_0,innovation_1,innovation_2,s_00,s_01,s_02,s_11,s_12,s_22,host_s";

/// Alignments of the brick's clock.
pub(super) const CLOCK: &str = "host_s,brick_s,offset_s,skew_ppm,uncertainty_s,round_trip_s,system,component";

/// Thermometers.
pub(super) const TEMPERATURE: &str =
    "t_s,arrival_s,channel,shown_deg_c,verdict,settled_deg_c,settled_sigma_deg_c,system,component";

/// Health of the links.
pub(super) const LINKS: &str = "host_s,link,bytes_in,bytes_out,frames_in,frames_out,frames_lost,checksum_errors,\
    garbage_bytes,unknown_ids,stalls,reconnects,drops_out,refused_frames,duplicates,forwarded,filtered,thinned,\
    round_trip_s,clock_uncertainty_s,queued_frames,queued_bytes";

/// What each sender sent.
pub(super) const SOURCES: &str = "host_s,link,system,component,frames,lost";

/// Everything else.
pub(super) const EVENTS: &str = "host_s,event,link,system,component,detail";
