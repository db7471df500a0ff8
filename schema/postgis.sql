-- The schema 0010 of msbdb for postgis.
-- Written by scripts/generate_schema; change msbdb.tables and the migrations instead.
-- :srid is the EPSG code of the database's one CRS, which must be in spatial_ref_sys.

CREATE EXTENSION IF NOT EXISTS postgis;

CREATE TABLE inventory_building (
  uid BIGINT NOT NULL,
  source TEXT NOT NULL,
  CONSTRAINT pk_inventory_building PRIMARY KEY (uid),
  CONSTRAINT ck_inventory_building_uid CHECK (uid > 0)
);

CREATE TABLE operator_state (
  uid BIGINT NOT NULL,
  state TEXT NOT NULL,
  operator TEXT NOT NULL,
  note TEXT NOT NULL,
  decided_at TEXT NOT NULL,
  CONSTRAINT pk_operator_state PRIMARY KEY (uid),
  CONSTRAINT ck_operator_state_state CHECK (state IN ('confirmed', 'refuted')),
  CONSTRAINT ck_operator_state_operator CHECK (operator <> '')
);

CREATE TABLE roof_sample (
  sample_id BIGINT NOT NULL,
  material TEXT NOT NULL,
  note TEXT NOT NULL,
  attributes JSON,
  CONSTRAINT pk_roof_sample PRIMARY KEY (sample_id),
  CONSTRAINT ck_roof_sample_sample_id CHECK (sample_id > 0),
  CONSTRAINT ck_roof_sample_material CHECK (material <> '')
);

CREATE TABLE survey (
  survey_id BIGINT NOT NULL,
  name TEXT NOT NULL,
  date TEXT NOT NULL,
  epsg INTEGER NOT NULL,
  crs_wkt TEXT NOT NULL,
  vertical_crs TEXT NOT NULL,
  density DOUBLE PRECISION NOT NULL,
  cell_m DOUBLE PRECISION NOT NULL,
  west DOUBLE PRECISION NOT NULL,
  south DOUBLE PRECISION NOT NULL,
  east DOUBLE PRECISION NOT NULL,
  north DOUBLE PRECISION NOT NULL,
  CONSTRAINT pk_survey PRIMARY KEY (survey_id),
  CONSTRAINT uq_survey UNIQUE (name),
  CONSTRAINT ck_survey_name CHECK (name <> ''),
  CONSTRAINT ck_survey_density CHECK (density >= 0 AND cell_m > 0),
  CONSTRAINT ck_survey_bounds CHECK (west < east AND south < north)
);

CREATE TABLE tile (
  survey TEXT NOT NULL,
  tile_row BIGINT NOT NULL,
  tile_column BIGINT NOT NULL,
  west DOUBLE PRECISION NOT NULL,
  south DOUBLE PRECISION NOT NULL,
  east DOUBLE PRECISION NOT NULL,
  north DOUBLE PRECISION NOT NULL,
  state TEXT NOT NULL,
  points BIGINT NOT NULL,
  halo_m DOUBLE PRECISION NOT NULL,
  seconds DOUBLE PRECISION NOT NULL,
  reason TEXT NOT NULL,
  build TEXT NOT NULL,
  result BYTEA,
  CONSTRAINT pk_tile PRIMARY KEY (survey, tile_row, tile_column),
  CONSTRAINT ck_tile_tile_bounds CHECK (west < east AND south < north),
  CONSTRAINT ck_tile_state CHECK (state IN ('queued', 'running', 'done', 'failed'))
);

CREATE TABLE building_version (
  version_id BIGINT NOT NULL,
  uid BIGINT NOT NULL,
  valid_from TEXT NOT NULL,
  valid_to TEXT,
  source TEXT NOT NULL,
  survey_id BIGINT,
  closed_by BIGINT,
  building_id BIGINT,
  state TEXT NOT NULL,
  z_ground DOUBLE PRECISION,
  z_ground_min DOUBLE PRECISION,
  z_ground_max DOUBLE PRECISION,
  z_eaves DOUBLE PRECISION,
  z_ridge DOUBLE PRECISION,
  eaves DOUBLE PRECISION,
  ridge DOUBLE PRECISION,
  storeys BIGINT,
  storeys_min BIGINT,
  storeys_max BIGINT,
  storeys_top BIGINT,
  h_max DOUBLE PRECISION,
  h_mean DOUBLE PRECISION,
  h_p50 DOUBLE PRECISION,
  h_p90 DOUBLE PRECISION,
  area_m2 DOUBLE PRECISION NOT NULL,
  volume_m3 DOUBLE PRECISION,
  parts BIGINT,
  flat_share DOUBLE PRECISION,
  area3d_share DOUBLE PRECISION,
  adaptive_share DOUBLE PRECISION,
  probability DOUBLE PRECISION,
  attributes JSON,
  CONSTRAINT pk_building_version PRIMARY KEY (version_id),
  CONSTRAINT ck_building_version_version_id CHECK (version_id > 0),
  CONSTRAINT ck_building_version_valid_from CHECK (length(valid_from) = 10),
  CONSTRAINT ck_building_version_valid_to CHECK (valid_to IS NULL OR (length(valid_to) = 10 AND valid_to >= valid_from)),
  CONSTRAINT ck_building_version_source CHECK (source IN ('survey', 'import')),
  CONSTRAINT ck_building_version_survey CHECK ((source = 'survey') = (survey_id IS NOT NULL)),
  CONSTRAINT ck_building_version_closed_by CHECK (closed_by IS NULL OR valid_to IS NOT NULL),
  CONSTRAINT ck_building_version_state CHECK (state IN ('confirmed', 'unsure', 'refuted')),
  CONSTRAINT ck_building_version_area CHECK (area_m2 > 0),
  CONSTRAINT ck_building_version_parts CHECK (storeys >= 0 AND parts >= 1),
  CONSTRAINT ck_building_version_heights CHECK (ridge >= eaves),
  CONSTRAINT ck_building_version_storeys CHECK (storeys_min >= 1 AND storeys_min <= storeys AND storeys <= storeys_max),
  CONSTRAINT ck_building_version_flat_share CHECK (flat_share >= 0 AND flat_share <= 1),
  CONSTRAINT ck_building_version_area3d_share CHECK (area3d_share >= 0 AND area3d_share <= 1),
  CONSTRAINT ck_building_version_adaptive_share CHECK (adaptive_share >= 0 AND adaptive_share <= 1),
  CONSTRAINT ck_building_version_probability CHECK (probability >= 0 AND probability <= 1),
  CONSTRAINT fk_building_version_inventory_building FOREIGN KEY(uid) REFERENCES inventory_building (uid),
  CONSTRAINT fk_building_version_survey FOREIGN KEY(survey_id) REFERENCES survey (survey_id),
  CONSTRAINT fk_building_version_closed_by FOREIGN KEY(closed_by) REFERENCES survey (survey_id)
);

CREATE INDEX ix_building_version_building_id ON building_version (building_id);

CREATE INDEX ix_building_version_closed_by ON building_version (closed_by);

CREATE UNIQUE INDEX ix_building_version_current ON building_version (uid) WHERE valid_to IS NULL;

CREATE INDEX ix_building_version_survey_id ON building_version (survey_id);

CREATE INDEX ix_building_version_uid_valid_from ON building_version (uid, valid_from);

CREATE TABLE inventory_event (
  number BIGINT NOT NULL,
  kind TEXT NOT NULL,
  name TEXT NOT NULL,
  date TEXT NOT NULL,
  survey_id BIGINT,
  counts JSON NOT NULL,
  content_sha256 TEXT NOT NULL,
  CONSTRAINT pk_inventory_event PRIMARY KEY (number),
  CONSTRAINT ck_inventory_event_number CHECK (number > 0),
  CONSTRAINT ck_inventory_event_kind CHECK (kind IN ('import', 'update')),
  CONSTRAINT ck_inventory_event_name CHECK (name <> ''),
  CONSTRAINT ck_inventory_event_date CHECK (length(date) = 10),
  CONSTRAINT ck_inventory_event_survey CHECK ((kind = 'update') = (survey_id IS NOT NULL)),
  CONSTRAINT fk_inventory_event_survey FOREIGN KEY(survey_id) REFERENCES survey (survey_id)
);

CREATE UNIQUE INDEX ix_inventory_event_survey_id ON inventory_event (survey_id);

CREATE TABLE run (
  run_id BIGINT NOT NULL,
  survey_id BIGINT NOT NULL,
  profile TEXT NOT NULL,
  version TEXT NOT NULL,
  parameters JSON NOT NULL,
  counts JSON NOT NULL,
  timings JSON NOT NULL,
  notices JSON NOT NULL,
  content_sha256 TEXT NOT NULL,
  CONSTRAINT pk_run PRIMARY KEY (run_id),
  CONSTRAINT fk_run_survey FOREIGN KEY(survey_id) REFERENCES survey (survey_id) ON DELETE CASCADE
);

CREATE UNIQUE INDEX ix_run_survey_id ON run (survey_id);

CREATE TABLE source (
  survey_id BIGINT NOT NULL,
  number INTEGER NOT NULL,
  name TEXT NOT NULL,
  role TEXT NOT NULL,
  sha256 TEXT NOT NULL,
  bytes BIGINT NOT NULL,
  CONSTRAINT pk_source PRIMARY KEY (survey_id, number),
  CONSTRAINT ck_source_bytes CHECK (bytes >= 0),
  CONSTRAINT fk_source_survey FOREIGN KEY(survey_id) REFERENCES survey (survey_id) ON DELETE CASCADE
);

CREATE TABLE survey_offset (
  survey_id BIGINT NOT NULL,
  dx_m DOUBLE PRECISION NOT NULL,
  dy_m DOUBLE PRECISION NOT NULL,
  dz_m DOUBLE PRECISION NOT NULL,
  pairs BIGINT NOT NULL,
  spread_m DOUBLE PRECISION,
  CONSTRAINT pk_survey_offset PRIMARY KEY (survey_id),
  CONSTRAINT ck_survey_offset_pairs CHECK (pairs >= 0),
  CONSTRAINT fk_survey_offset_survey FOREIGN KEY(survey_id) REFERENCES survey (survey_id)
);

CREATE TABLE building_change (
  change_id BIGINT NOT NULL,
  survey_id BIGINT NOT NULL,
  kind TEXT NOT NULL,
  uid_before BIGINT,
  uid_after BIGINT,
  version_before BIGINT,
  version_after BIGINT,
  outline BOOLEAN NOT NULL,
  height BOOLEAN NOT NULL,
  parts BOOLEAN NOT NULL,
  overlap_m2 DOUBLE PRECISION NOT NULL,
  iou DOUBLE PRECISION NOT NULL,
  dh_m DOUBLE PRECISION,
  darea_m2 DOUBLE PRECISION NOT NULL,
  note TEXT NOT NULL,
  CONSTRAINT pk_building_change PRIMARY KEY (change_id),
  CONSTRAINT ck_building_change_change_id CHECK (change_id > 0),
  CONSTRAINT ck_building_change_kind CHECK (kind IN ('unchanged', 'modified', 'new', 'demolished', 'merged', 'split')),
  CONSTRAINT ck_building_change_uid CHECK (uid_before IS NOT NULL OR uid_after IS NOT NULL),
  CONSTRAINT ck_building_change_version CHECK ((uid_before IS NULL) = (version_before IS NULL) AND (uid_after IS NULL) = (version_after IS NULL)),
  CONSTRAINT ck_building_change_overlap CHECK (overlap_m2 >= 0 AND iou >= 0 AND iou <= 1),
  CONSTRAINT fk_building_change_survey FOREIGN KEY(survey_id) REFERENCES survey (survey_id),
  CONSTRAINT fk_building_change_uid_before FOREIGN KEY(uid_before) REFERENCES inventory_building (uid),
  CONSTRAINT fk_building_change_uid_after FOREIGN KEY(uid_after) REFERENCES inventory_building (uid),
  CONSTRAINT fk_building_change_version_before FOREIGN KEY(version_before) REFERENCES building_version (version_id),
  CONSTRAINT fk_building_change_version_after FOREIGN KEY(version_after) REFERENCES building_version (version_id)
);

CREATE INDEX ix_building_change_survey_id_kind ON building_change (survey_id, kind);

CREATE INDEX ix_building_change_uid_after ON building_change (uid_after);

CREATE INDEX ix_building_change_uid_before ON building_change (uid_before);

CREATE INDEX ix_building_change_version_after ON building_change (version_after);

CREATE INDEX ix_building_change_version_before ON building_change (version_before);

CREATE TABLE candidate_region (
  candidate_id BIGINT NOT NULL,
  run_id BIGINT NOT NULL,
  method TEXT NOT NULL,
  rule TEXT NOT NULL,
  height_scale_m DOUBLE PRECISION,
  points BIGINT NOT NULL,
  area_m2 DOUBLE PRECISION NOT NULL,
  perimeter BIGINT NOT NULL,
  mbr_m2 DOUBLE PRECISION NOT NULL,
  rectangularity DOUBLE PRECISION NOT NULL,
  compactness DOUBLE PRECISION,
  linearity DOUBLE PRECISION,
  direction_1 DOUBLE PRECISION,
  direction_2 DOUBLE PRECISION,
  ndvi DOUBLE PRECISION,
  h_max DOUBLE PRECISION NOT NULL,
  h_mean DOUBLE PRECISION NOT NULL,
  h_p50 DOUBLE PRECISION NOT NULL,
  h_p90 DOUBLE PRECISION NOT NULL,
  h_std DOUBLE PRECISION NOT NULL,
  xcen DOUBLE PRECISION NOT NULL,
  ycen DOUBLE PRECISION NOT NULL,
  CONSTRAINT pk_candidate_region PRIMARY KEY (candidate_id),
  CONSTRAINT ck_candidate_region_candidate_id CHECK (candidate_id > 0),
  CONSTRAINT ck_candidate_region_method CHECK (method IN ('area3d', 'adaptive')),
  CONSTRAINT ck_candidate_region_rule CHECK (rule <> ''),
  CONSTRAINT ck_candidate_region_height_scale CHECK (height_scale_m IS NULL OR method = 'area3d'),
  CONSTRAINT ck_candidate_region_points CHECK (points > 0 AND perimeter >= 0),
  CONSTRAINT ck_candidate_region_shape CHECK (area_m2 > 0 AND mbr_m2 >= 0 AND rectangularity >= 0 AND compactness >= 0),
  CONSTRAINT ck_candidate_region_linearity CHECK (linearity >= 0 AND linearity <= 1),
  CONSTRAINT ck_candidate_region_direction_1 CHECK (direction_1 >= 0 AND direction_1 <= 180),
  CONSTRAINT ck_candidate_region_direction_2 CHECK (direction_2 >= 0 AND direction_2 <= 180),
  CONSTRAINT ck_candidate_region_ndvi CHECK (ndvi >= -1 AND ndvi <= 1),
  CONSTRAINT fk_candidate_region_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE INDEX ix_candidate_region_run_id_method ON candidate_region (run_id, method);

CREATE TABLE flat_region (
  region_id BIGINT NOT NULL,
  run_id BIGINT NOT NULL,
  zone BIGINT NOT NULL,
  lambda_low_m2 DOUBLE PRECISION NOT NULL,
  lambda_m2 DOUBLE PRECISION NOT NULL,
  gradient_sum DOUBLE PRECISION NOT NULL,
  mean_gradient DOUBLE PRECISION NOT NULL,
  area_m2 DOUBLE PRECISION NOT NULL,
  perimeter_m DOUBLE PRECISION NOT NULL,
  compactness DOUBLE PRECISION NOT NULL,
  h_max DOUBLE PRECISION NOT NULL,
  h_mean DOUBLE PRECISION NOT NULL,
  h_p50 DOUBLE PRECISION NOT NULL,
  h_p90 DOUBLE PRECISION NOT NULL,
  h_std DOUBLE PRECISION NOT NULL,
  xcen DOUBLE PRECISION NOT NULL,
  ycen DOUBLE PRECISION NOT NULL,
  CONSTRAINT pk_flat_region PRIMARY KEY (region_id),
  CONSTRAINT ck_flat_region_region_id CHECK (region_id > 0),
  CONSTRAINT ck_flat_region_zone CHECK (zone >= 0 AND lambda_low_m2 >= 0 AND lambda_low_m2 <= lambda_m2),
  CONSTRAINT ck_flat_region_gradient CHECK (gradient_sum >= 0 AND mean_gradient >= 0),
  CONSTRAINT ck_flat_region_shape CHECK (area_m2 > 0 AND perimeter_m > 0 AND compactness > 0),
  CONSTRAINT fk_flat_region_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE INDEX ix_flat_region_run_id_zone ON flat_region (run_id, zone);

CREATE TABLE raster_tile (
  run_id BIGINT NOT NULL,
  name TEXT NOT NULL,
  lattice_row BIGINT NOT NULL,
  lattice_column BIGINT NOT NULL,
  dtype TEXT NOT NULL,
  shape JSON NOT NULL,
  data BYTEA NOT NULL,
  CONSTRAINT pk_raster_tile PRIMARY KEY (run_id, name, lattice_row, lattice_column),
  CONSTRAINT fk_raster_tile_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE TABLE rejection (
  rejection_id BIGINT NOT NULL,
  run_id BIGINT NOT NULL,
  region_id BIGINT NOT NULL,
  method TEXT NOT NULL,
  stage TEXT NOT NULL,
  reason TEXT NOT NULL,
  scale BIGINT NOT NULL,
  area_m2 DOUBLE PRECISION NOT NULL,
  xcen DOUBLE PRECISION NOT NULL,
  ycen DOUBLE PRECISION NOT NULL,
  CONSTRAINT pk_rejection PRIMARY KEY (rejection_id),
  CONSTRAINT ck_rejection_method CHECK (method IN ('multiscale', 'flatregions', 'area3d', 'adaptive')),
  CONSTRAINT ck_rejection_reason CHECK (stage <> '' AND reason <> ''),
  CONSTRAINT ck_rejection_area CHECK (scale >= 0 AND area_m2 >= 0),
  CONSTRAINT fk_rejection_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE INDEX ix_rejection_run_id_method_stage_reason ON rejection (run_id, method, stage, reason);

CREATE TABLE rejection_count (
  run_id BIGINT NOT NULL,
  method TEXT NOT NULL,
  number BIGINT NOT NULL,
  stage TEXT NOT NULL,
  reason TEXT NOT NULL,
  regions BIGINT NOT NULL,
  area_m2 DOUBLE PRECISION NOT NULL,
  small BIGINT NOT NULL,
  small_m2 DOUBLE PRECISION NOT NULL,
  CONSTRAINT pk_rejection_count PRIMARY KEY (run_id, method, number),
  CONSTRAINT ck_rejection_count_method CHECK (method IN ('multiscale', 'flatregions', 'area3d', 'adaptive')),
  CONSTRAINT ck_rejection_count_number CHECK (number >= 1 AND number <= 255),
  CONSTRAINT ck_rejection_count_reason CHECK (stage <> '' AND reason <> ''),
  CONSTRAINT ck_rejection_count_regions CHECK (regions >= 1 AND small >= 0 AND small <= regions),
  CONSTRAINT ck_rejection_count_area CHECK (small_m2 >= 0 AND area_m2 >= small_m2),
  CONSTRAINT fk_rejection_count_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE TABLE run_method (
  run_id BIGINT NOT NULL,
  method TEXT NOT NULL,
  CONSTRAINT pk_run_method PRIMARY KEY (run_id, method),
  CONSTRAINT ck_run_method_method CHECK (method IN ('multiscale', 'flatregions', 'area3d', 'adaptive')),
  CONSTRAINT fk_run_method_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE TABLE run_state (
  run_id BIGINT NOT NULL,
  name TEXT NOT NULL,
  dtype TEXT NOT NULL,
  shape JSON NOT NULL,
  data BYTEA NOT NULL,
  CONSTRAINT pk_run_state PRIMARY KEY (run_id, name),
  CONSTRAINT fk_run_state_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE TABLE scale (
  run_id BIGINT NOT NULL,
  scale BIGINT NOT NULL,
  threshold_px BIGINT NOT NULL,
  threshold_m2 DOUBLE PRECISION NOT NULL,
  CONSTRAINT pk_scale PRIMARY KEY (run_id, scale),
  CONSTRAINT ck_scale_scale CHECK (scale >= 1),
  CONSTRAINT ck_scale_threshold CHECK (threshold_px >= 1 AND threshold_m2 > 0),
  CONSTRAINT fk_scale_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE TABLE spectral_class (
  run_id BIGINT NOT NULL,
  speindex BIGINT NOT NULL,
  label TEXT NOT NULL,
  labelled_by TEXT NOT NULL,
  source TEXT NOT NULL,
  cells BIGINT NOT NULL,
  share DOUBLE PRECISION NOT NULL,
  ndvi DOUBLE PRECISION,
  brightness DOUBLE PRECISION,
  roughness_m DOUBLE PRECISION,
  height_m DOUBLE PRECISION NOT NULL,
  CONSTRAINT pk_spectral_class PRIMARY KEY (run_id, speindex),
  CONSTRAINT ck_spectral_class_speindex CHECK (speindex >= 1),
  CONSTRAINT ck_spectral_class_cells CHECK (cells >= 0 AND share >= 0),
  CONSTRAINT ck_spectral_class_label CHECK (label IN ('building', 'vegetation', 'shadow', 'water', 'other')),
  CONSTRAINT ck_spectral_class_labelled_by CHECK (labelled_by IN ('automatic', 'operator')),
  CONSTRAINT ck_spectral_class_source CHECK (source IN ('spectral', 'structure')),
  CONSTRAINT fk_spectral_class_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE TABLE survey_plan (
  run_id BIGINT NOT NULL,
  plan JSON NOT NULL,
  CONSTRAINT pk_survey_plan PRIMARY KEY (run_id),
  CONSTRAINT fk_survey_plan_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE TABLE building (
  building_id BIGINT NOT NULL,
  run_id BIGINT NOT NULL,
  state TEXT NOT NULL,
  probability DOUBLE PRECISION,
  z_ground DOUBLE PRECISION,
  z_ground_min DOUBLE PRECISION,
  z_ground_max DOUBLE PRECISION,
  z_eaves DOUBLE PRECISION,
  z_ridge DOUBLE PRECISION,
  eaves DOUBLE PRECISION,
  ridge DOUBLE PRECISION,
  storeys BIGINT NOT NULL,
  storeys_min BIGINT,
  storeys_max BIGINT,
  storeys_top BIGINT,
  h_max DOUBLE PRECISION NOT NULL,
  h_mean DOUBLE PRECISION NOT NULL,
  h_p50 DOUBLE PRECISION NOT NULL,
  h_p90 DOUBLE PRECISION NOT NULL,
  area_m2 DOUBLE PRECISION NOT NULL,
  volume_m3 DOUBLE PRECISION NOT NULL,
  floor_area_m2 DOUBLE PRECISION,
  trees BIGINT NOT NULL,
  parts BIGINT NOT NULL,
  scales BIGINT NOT NULL,
  speindex BIGINT NOT NULL,
  class_id BIGINT GENERATED ALWAYS AS (nullif(speindex, 0)) STORED,
  building_share DOUBLE PRECISION NOT NULL,
  xcen DOUBLE PRECISION NOT NULL,
  ycen DOUBLE PRECISION NOT NULL,
  xin DOUBLE PRECISION NOT NULL,
  yin DOUBLE PRECISION NOT NULL,
  multiscale_share DOUBLE PRECISION,
  flat_share DOUBLE PRECISION,
  area3d_share DOUBLE PRECISION,
  adaptive_share DOUBLE PRECISION,
  coverage DOUBLE PRECISION,
  nodata_share DOUBLE PRECISION,
  density DOUBLE PRECISION,
  divided_by TEXT NOT NULL,
  outline_source TEXT NOT NULL,
  CONSTRAINT pk_building PRIMARY KEY (building_id),
  CONSTRAINT uq_building UNIQUE (building_id, run_id),
  CONSTRAINT fk_building_spectral_class FOREIGN KEY(run_id, class_id) REFERENCES spectral_class (run_id, speindex),
  CONSTRAINT ck_building_building_id CHECK (building_id > 0),
  CONSTRAINT ck_building_state CHECK (state IN ('confirmed', 'unsure', 'refuted')),
  CONSTRAINT ck_building_outline_source CHECK (outline_source IN ('fitted', 'traced')),
  CONSTRAINT ck_building_size CHECK (storeys >= 0 AND area_m2 > 0),
  CONSTRAINT ck_building_heights CHECK (ridge >= eaves),
  CONSTRAINT ck_building_storeys CHECK (storeys_min >= 1 AND storeys_min <= storeys AND storeys <= storeys_max),
  CONSTRAINT ck_building_parts CHECK (trees >= 1 AND parts >= trees AND scales >= 1),
  CONSTRAINT ck_building_probability CHECK (probability >= 0 AND probability <= 1),
  CONSTRAINT ck_building_building_share CHECK (building_share >= 0 AND building_share <= 1),
  CONSTRAINT ck_building_multiscale_share CHECK (multiscale_share >= 0 AND multiscale_share <= 1),
  CONSTRAINT ck_building_flat_share CHECK (flat_share >= 0 AND flat_share <= 1),
  CONSTRAINT ck_building_area3d_share CHECK (area3d_share >= 0 AND area3d_share <= 1),
  CONSTRAINT ck_building_adaptive_share CHECK (adaptive_share >= 0 AND adaptive_share <= 1),
  CONSTRAINT ck_building_coverage CHECK (coverage >= 0 AND coverage <= 1),
  CONSTRAINT ck_building_nodata_share CHECK (nodata_share >= 0 AND nodata_share <= 1),
  CONSTRAINT fk_building_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE INDEX ix_building_run_id_class_id ON building (run_id, class_id);

CREATE TABLE flat_region_candidate (
  region_id BIGINT NOT NULL,
  candidate_id BIGINT NOT NULL,
  run_id BIGINT NOT NULL,
  overlap_m2 DOUBLE PRECISION NOT NULL,
  region_share DOUBLE PRECISION NOT NULL,
  candidate_share DOUBLE PRECISION NOT NULL,
  CONSTRAINT pk_flat_region_candidate PRIMARY KEY (region_id, candidate_id),
  CONSTRAINT ck_flat_region_candidate_overlap CHECK (overlap_m2 > 0),
  CONSTRAINT ck_flat_region_candidate_region_share CHECK (region_share > 0 AND region_share <= 1),
  CONSTRAINT ck_flat_region_candidate_candidate_share CHECK (candidate_share > 0 AND candidate_share <= 1),
  CONSTRAINT fk_flat_region_candidate_flat_region FOREIGN KEY(region_id) REFERENCES flat_region (region_id) ON DELETE CASCADE,
  CONSTRAINT fk_flat_region_candidate_candidate_region FOREIGN KEY(candidate_id) REFERENCES candidate_region (candidate_id) ON DELETE CASCADE,
  CONSTRAINT fk_flat_region_candidate_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE INDEX ix_flat_region_candidate_candidate_id ON flat_region_candidate (candidate_id);

CREATE INDEX ix_flat_region_candidate_run_id ON flat_region_candidate (run_id);

CREATE TABLE spectral_class_band (
  run_id BIGINT NOT NULL,
  speindex BIGINT NOT NULL,
  band TEXT NOT NULL,
  mean DOUBLE PRECISION NOT NULL,
  CONSTRAINT pk_spectral_class_band PRIMARY KEY (run_id, speindex, band),
  CONSTRAINT fk_spectral_class_band_spectral_class FOREIGN KEY(run_id, speindex) REFERENCES spectral_class (run_id, speindex) ON DELETE CASCADE
);

CREATE TABLE part (
  part_id BIGINT NOT NULL,
  run_id BIGINT NOT NULL,
  supid BIGINT NOT NULL,
  father_id BIGINT GENERATED ALWAYS AS (nullif(supid, 0)) STORED,
  supscale BIGINT NOT NULL,
  root_id BIGINT NOT NULL,
  building_id BIGINT NOT NULL,
  scale BIGINT NOT NULL,
  hindex BIGINT NOT NULL,
  hzone BIGINT NOT NULL,
  speindex BIGINT NOT NULL,
  class_id BIGINT GENERATED ALWAYS AS (nullif(speindex, 0)) STORED,
  xo DOUBLE PRECISION NOT NULL,
  yo DOUBLE PRECISION NOT NULL,
  xcen DOUBLE PRECISION NOT NULL,
  ycen DOUBLE PRECISION NOT NULL,
  xin DOUBLE PRECISION NOT NULL,
  yin DOUBLE PRECISION NOT NULL,
  area_px BIGINT NOT NULL,
  area_m2 DOUBLE PRECISION NOT NULL,
  stddis DOUBLE PRECISION,
  h_max DOUBLE PRECISION NOT NULL,
  h_mean DOUBLE PRECISION NOT NULL,
  h_p50 DOUBLE PRECISION NOT NULL,
  h_p90 DOUBLE PRECISION NOT NULL,
  h_std DOUBLE PRECISION NOT NULL,
  building_share DOUBLE PRECISION NOT NULL,
  outline_source TEXT NOT NULL,
  CONSTRAINT pk_part PRIMARY KEY (part_id),
  CONSTRAINT uq_part UNIQUE (part_id, scale, root_id, run_id),
  CONSTRAINT fk_part_part FOREIGN KEY(father_id, supscale, root_id, run_id) REFERENCES part (part_id, scale, root_id, run_id) DEFERRABLE INITIALLY DEFERRED,
  CONSTRAINT fk_part_building FOREIGN KEY(building_id, run_id) REFERENCES building (building_id, run_id) DEFERRABLE INITIALLY DEFERRED,
  CONSTRAINT fk_part_scale FOREIGN KEY(run_id, scale) REFERENCES scale (run_id, scale),
  CONSTRAINT fk_part_spectral_class FOREIGN KEY(run_id, class_id) REFERENCES spectral_class (run_id, speindex),
  CONSTRAINT ck_part_part_id CHECK (part_id > 0),
  CONSTRAINT ck_part_father CHECK ((supid = 0 AND supscale = 0 AND root_id = part_id) OR (supid > 0 AND supscale > 0 AND supscale < scale)),
  CONSTRAINT ck_part_area CHECK (area_px > 0 AND area_m2 > 0),
  CONSTRAINT ck_part_storeys CHECK (hindex >= 0 AND hzone >= 0),
  CONSTRAINT ck_part_outline_source CHECK (outline_source IN ('fitted', 'traced')),
  CONSTRAINT ck_part_building_share CHECK (building_share >= 0 AND building_share <= 1),
  CONSTRAINT fk_part_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE INDEX ix_part_building_id_run_id ON part (building_id, run_id);

CREATE INDEX ix_part_father_id ON part (father_id);

CREATE INDEX ix_part_run_id_scale_class_id ON part (run_id, scale, class_id);

CREATE TABLE part_candidate (
  part_id BIGINT NOT NULL,
  candidate_id BIGINT NOT NULL,
  run_id BIGINT NOT NULL,
  overlap_m2 DOUBLE PRECISION NOT NULL,
  part_share DOUBLE PRECISION NOT NULL,
  candidate_share DOUBLE PRECISION NOT NULL,
  CONSTRAINT pk_part_candidate PRIMARY KEY (part_id, candidate_id),
  CONSTRAINT ck_part_candidate_overlap CHECK (overlap_m2 > 0),
  CONSTRAINT ck_part_candidate_part_share CHECK (part_share > 0 AND part_share <= 1),
  CONSTRAINT ck_part_candidate_candidate_share CHECK (candidate_share > 0 AND candidate_share <= 1),
  CONSTRAINT fk_part_candidate_part FOREIGN KEY(part_id) REFERENCES part (part_id) ON DELETE CASCADE,
  CONSTRAINT fk_part_candidate_candidate_region FOREIGN KEY(candidate_id) REFERENCES candidate_region (candidate_id) ON DELETE CASCADE,
  CONSTRAINT fk_part_candidate_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE INDEX ix_part_candidate_candidate_id ON part_candidate (candidate_id);

CREATE INDEX ix_part_candidate_run_id ON part_candidate (run_id);

CREATE TABLE part_flat_region (
  part_id BIGINT NOT NULL,
  region_id BIGINT NOT NULL,
  run_id BIGINT NOT NULL,
  overlap_m2 DOUBLE PRECISION NOT NULL,
  part_share DOUBLE PRECISION NOT NULL,
  region_share DOUBLE PRECISION NOT NULL,
  CONSTRAINT pk_part_flat_region PRIMARY KEY (part_id, region_id),
  CONSTRAINT ck_part_flat_region_overlap CHECK (overlap_m2 > 0),
  CONSTRAINT ck_part_flat_region_part_share CHECK (part_share > 0 AND part_share <= 1),
  CONSTRAINT ck_part_flat_region_region_share CHECK (region_share > 0 AND region_share <= 1),
  CONSTRAINT fk_part_flat_region_part FOREIGN KEY(part_id) REFERENCES part (part_id) ON DELETE CASCADE,
  CONSTRAINT fk_part_flat_region_flat_region FOREIGN KEY(region_id) REFERENCES flat_region (region_id) ON DELETE CASCADE,
  CONSTRAINT fk_part_flat_region_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE INDEX ix_part_flat_region_region_id ON part_flat_region (region_id);

CREATE INDEX ix_part_flat_region_run_id ON part_flat_region (run_id);

ALTER TABLE part ADD COLUMN geometry geometry(MULTIPOLYGON, :srid) NOT NULL;

CREATE INDEX idx_part_geometry ON part USING gist (geometry);

ALTER TABLE building ADD COLUMN geometry geometry(MULTIPOLYGON, :srid) NOT NULL;

CREATE INDEX idx_building_geometry ON building USING gist (geometry);

ALTER TABLE rejection ADD COLUMN geometry geometry(POINT, :srid) NOT NULL;

CREATE INDEX idx_rejection_geometry ON rejection USING gist (geometry);

ALTER TABLE flat_region ADD COLUMN geometry geometry(MULTIPOLYGON, :srid) NOT NULL;

CREATE INDEX idx_flat_region_geometry ON flat_region USING gist (geometry);

ALTER TABLE candidate_region ADD COLUMN geometry geometry(MULTIPOLYGON, :srid) NOT NULL;

CREATE INDEX idx_candidate_region_geometry ON candidate_region USING gist (geometry);

ALTER TABLE building_version ADD COLUMN geometry geometry(MULTIPOLYGON, :srid) NOT NULL;

CREATE INDEX idx_building_version_geometry ON building_version USING gist (geometry);

ALTER TABLE inventory_event ADD COLUMN geometry geometry(MULTIPOLYGON, :srid) NOT NULL;

CREATE INDEX idx_inventory_event_geometry ON inventory_event USING gist (geometry);

ALTER TABLE roof_sample ADD COLUMN geometry geometry(POINT, :srid) NOT NULL;

CREATE INDEX idx_roof_sample_geometry ON roof_sample USING gist (geometry);

ALTER TABLE inventory_building ADD COLUMN row_digest BIGINT;

ALTER TABLE building_version ADD COLUMN row_digest BIGINT;

ALTER TABLE building_change ADD COLUMN row_digest BIGINT;

ALTER TABLE survey_offset ADD COLUMN row_digest BIGINT;

ALTER TABLE inventory_event ADD COLUMN row_digest BIGINT;

ALTER TABLE operator_state ADD COLUMN row_digest BIGINT;

ALTER TABLE roof_sample ADD COLUMN row_digest BIGINT;

CREATE VIEW roof_material_by_class AS
SELECT s.name AS survey, m.material, p.speindex, c.label AS class_label, COUNT(*) AS samples
FROM roof_sample AS m
JOIN part AS p ON ST_Intersects(p.geometry, m.geometry)
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN spectral_class AS c ON c.run_id = p.run_id AND c.speindex = p.class_id
WHERE NOT EXISTS (
  SELECT 1 FROM part AS f
  WHERE f.building_id = p.building_id AND f.root_id = p.root_id AND f.scale > p.scale
    AND ST_Intersects(f.geometry, m.geometry)
)
GROUP BY s.name, m.material, p.speindex, c.label;

CREATE VIEW building_piece AS
WITH RECURSIVE piece (version_id, member_id) AS (
  SELECT version_after, version_before FROM building_change WHERE note LIKE 'across a border: %'
  UNION
  SELECT piece.version_id, c.version_before
  FROM piece JOIN building_change AS c ON c.version_after = piece.member_id AND c.note LIKE 'across a border: %'
)
SELECT version_id, building_id FROM building_version WHERE building_id IS NOT NULL
UNION ALL
SELECT DISTINCT v.version_id, m.building_id
FROM piece
JOIN building_version AS v ON v.version_id = piece.version_id
JOIN building_version AS m ON m.version_id = piece.member_id
WHERE m.building_id <> v.building_id;

CREATE VIEW footprint AS
SELECT b.building_id, s.name AS survey, b.state, b.probability, b.storeys, b.storeys_min, b.storeys_max,
       b.storeys_top, b.z_ground, b.eaves, b.ridge, b.z_eaves, b.z_ridge, b.speindex, b.area_m2,
       b.h_max, b.h_mean, b.h_p50, b.h_p90, b.trees, b.parts, b.divided_by, b.outline_source, b.xin, b.yin, b.geometry
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id;

CREATE VIEW part_tree AS
WITH RECURSIVE tree (part_id, depth, path) AS (
  SELECT part_id, 0, CAST(part_id AS TEXT) FROM part WHERE supid = 0
  UNION ALL
  SELECT child.part_id, tree.depth + 1, tree.path || '/' || CAST(child.part_id AS TEXT)
  FROM tree JOIN part AS child ON child.father_id = tree.part_id
)
SELECT p.part_id, s.name AS survey, p.building_id, p.root_id, p.supid, p.supscale, p.scale, tree.depth, tree.path,
       p.hindex, p.speindex, p.area_m2, p.stddis, p.h_max, p.h_p90, p.outline_source, p.geometry
FROM tree
JOIN part AS p ON p.part_id = tree.part_id
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id;

CREATE VIEW building_summary AS
SELECT b.building_id, s.name AS survey, s.date AS survey_date, b.state, b.probability, b.storeys,
       b.storeys_min, b.storeys_max, b.storeys_top, b.z_ground, b.z_ground_min, b.z_ground_max, b.eaves, b.ridge,
       b.z_eaves, b.z_ridge, s.vertical_crs, b.coverage, b.nodata_share, b.density,
       b.multiscale_share, b.flat_share, b.area3d_share, b.adaptive_share, b.h_max, b.h_mean, b.h_p50, b.h_p90,
       b.area_m2, b.volume_m3,
       COALESCE(b.floor_area_m2,
       (SELECT SUM(p.area_m2 * CASE WHEN p.hindex > COALESCE(f.hindex, 0)
                               THEN p.hindex - COALESCE(f.hindex, 0) ELSE 0 END)
        FROM part AS p LEFT JOIN part AS f ON f.part_id = p.father_id
        WHERE p.building_id = b.building_id)) AS floor_area_m2,
       b.trees, b.parts, b.scales, b.speindex, c.label AS class_label, b.divided_by, b.outline_source,
       b.xcen, b.ycen, b.xin, b.yin, b.geometry
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN spectral_class AS c ON c.run_id = b.run_id AND c.speindex = b.class_id;

CREATE VIEW part_evidence AS
SELECT p.part_id, s.name AS survey, p.building_id, p.root_id, p.supid, p.scale, p.hindex, p.area_m2, p.building_share,
       CASE WHEN flat.method IS NOT NULL THEN COALESCE((
         SELECT SUM(l.part_share) FROM part_flat_region AS l WHERE l.part_id = p.part_id), 0.0) END AS flat_share,
       CASE WHEN flat.method IS NOT NULL THEN (
         SELECT COUNT(*) FROM part_flat_region AS l WHERE l.part_id = p.part_id) END AS flat_regions,
       CASE WHEN area3d.method IS NOT NULL THEN COALESCE((
         SELECT SUM(l.part_share) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'area3d'), 0.0) END AS area3d_share,
       CASE WHEN area3d.method IS NOT NULL THEN (
         SELECT COUNT(*) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'area3d') END AS area3d_regions,
       CASE WHEN adaptive.method IS NOT NULL THEN COALESCE((
         SELECT SUM(l.part_share) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'adaptive'), 0.0) END AS adaptive_share,
       CASE WHEN adaptive.method IS NOT NULL THEN (
         SELECT COUNT(*) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'adaptive') END AS adaptive_regions,
       p.geometry
FROM part AS p
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN run_method AS flat ON flat.run_id = p.run_id AND flat.method = 'flatregions'
LEFT JOIN run_method AS area3d ON area3d.run_id = p.run_id AND area3d.method = 'area3d'
LEFT JOIN run_method AS adaptive ON adaptive.run_id = p.run_id AND adaptive.method = 'adaptive';

CREATE VIEW unexplained_flat_region AS
SELECT f.region_id, s.name AS survey, f.zone, f.lambda_low_m2, f.lambda_m2, f.gradient_sum, f.mean_gradient,
       f.area_m2, f.perimeter_m, f.compactness, f.h_max, f.h_mean, f.h_p50, f.h_p90, f.h_std, f.xcen, f.ycen,
       COALESCE((
         SELECT SUM(l.region_share) FROM part_flat_region AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.region_id = f.region_id AND root.supid = 0), 0.0) AS explained_share, f.geometry
FROM flat_region AS f
JOIN run AS r ON r.run_id = f.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE COALESCE((
         SELECT SUM(l.region_share) FROM part_flat_region AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.region_id = f.region_id AND root.supid = 0), 0.0) < 0.5;

CREATE VIEW candidate_evidence AS
SELECT k.candidate_id, s.name AS survey, k.method, k.rule, k.height_scale_m, k.points, k.area_m2, k.rectangularity,
       k.compactness, k.linearity, k.ndvi, k.h_p50, k.h_p90, k.h_std, k.xcen, k.ycen,
       CASE WHEN multiscale.method IS NOT NULL THEN COALESCE((
         SELECT SUM(l.candidate_share) FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.candidate_id = k.candidate_id AND root.supid = 0), 0.0) END AS explained_share,
       CASE WHEN flat.method IS NOT NULL THEN COALESCE((
         SELECT SUM(l.candidate_share) FROM flat_region_candidate AS l WHERE l.candidate_id = k.candidate_id), 0.0) END
         AS flat_share,
       k.geometry
FROM candidate_region AS k
JOIN run AS r ON r.run_id = k.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN run_method AS multiscale ON multiscale.run_id = k.run_id AND multiscale.method = 'multiscale'
LEFT JOIN run_method AS flat ON flat.run_id = k.run_id AND flat.method = 'flatregions';

CREATE VIEW unexplained_candidate AS
SELECT k.candidate_id, s.name AS survey, k.method, k.rule, k.height_scale_m, k.points, k.area_m2, k.rectangularity,
       k.compactness, k.linearity, k.ndvi, k.h_max, k.h_mean, k.h_p50, k.h_p90, k.h_std, k.xcen, k.ycen,
       COALESCE((
         SELECT SUM(l.candidate_share) FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.candidate_id = k.candidate_id AND root.supid = 0), 0.0) AS explained_share, k.geometry
FROM candidate_region AS k
JOIN run AS r ON r.run_id = k.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE COALESCE((
         SELECT SUM(l.candidate_share) FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.candidate_id = k.candidate_id AND root.supid = 0), 0.0) < 0.5;

CREATE VIEW building_evidence AS
SELECT b.building_id, s.name AS survey, b.state, b.probability, b.storeys, b.h_p90, b.area_m2, b.building_share,
       b.multiscale_share, b.flat_share, b.area3d_share, b.adaptive_share,
       CASE WHEN b.building_share >= 0.5 THEN 1 ELSE 0 END AS classes_for,
       CASE WHEN b.flat_share IS NULL THEN 0 ELSE 1 END + CASE WHEN b.area3d_share IS NULL THEN 0 ELSE 1 END
         + CASE WHEN b.adaptive_share IS NULL THEN 0 ELSE 1 END AS extractors_heard,
       CASE WHEN b.flat_share >= 0.1 THEN 1 ELSE 0 END
         + CASE WHEN b.area3d_share >= 0.1 THEN 1 ELSE 0 END
         + CASE WHEN b.adaptive_share >= 0.1 THEN 1 ELSE 0 END AS extractors_for,
       b.geometry
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id;

CREATE VIEW footprint_current AS
SELECT v.version_id, v.uid, v.valid_from, v.valid_to, v.source, s.name AS survey, COALESCE(o.state, v.state) AS state,
       v.state AS found_state, o.operator, o.note, v.storeys, v.storeys_min, v.storeys_max, v.storeys_top, v.z_ground,
       v.eaves, v.ridge, v.z_eaves, v.z_ridge, v.h_max, v.h_mean, v.h_p50, v.h_p90, v.area_m2, v.volume_m3,
       v.parts, v.flat_share, v.area3d_share, v.adaptive_share, v.probability, v.building_id,
       COALESCE(v.attributes, '{}') AS attributes,
       v.geometry
FROM building_version AS v
LEFT JOIN survey AS s ON s.survey_id = v.survey_id
LEFT JOIN operator_state AS o ON o.uid = v.uid
WHERE v.valid_to IS NULL;

CREATE VIEW part_current AS
SELECT p.part_id, s.name AS survey, v.building_id, p.supid, p.supscale, p.root_id, p.scale, p.hindex, p.hzone,
       p.speindex, p.xo, p.yo, p.xcen, p.ycen, p.xin, p.yin, p.area_px, p.area_m2, p.stddis, p.h_max, p.h_mean,
       p.h_p50, p.h_p90, p.h_std, p.building_share, p.outline_source, p.geometry
FROM part AS p
JOIN building_piece AS b ON b.building_id = p.building_id
JOIN building_version AS v ON v.version_id = b.version_id
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE v.valid_to IS NULL;

CREATE VIEW building_history AS
SELECT v.version_id, v.uid, v.valid_from, v.valid_to, v.source, s.name AS survey,
       COALESCE((SELECT MIN(c.kind) FROM building_change AS c
                 WHERE c.version_after = v.version_id AND c.survey_id = v.survey_id), 'imported') AS began_as,
       e.name AS ended_in,
       (SELECT MIN(c.kind) FROM building_change AS c
        WHERE c.version_before = v.version_id AND c.survey_id = v.closed_by) AS ended_as,
       v.state, v.probability, v.storeys, v.eaves, v.ridge, v.z_ground, v.h_max, v.h_p90, v.area_m2, v.volume_m3, v.geometry
FROM building_version AS v
LEFT JOIN survey AS s ON s.survey_id = v.survey_id
LEFT JOIN survey AS e ON e.survey_id = v.closed_by;

CREATE FUNCTION footprint_at(day date)
RETURNS TABLE (
  version_id bigint, uid bigint, valid_from text, valid_to text, source text, survey text, state text,
  found_state text, operator text, note text, storeys bigint, storeys_min bigint, storeys_max bigint,
  storeys_top bigint, z_ground double precision, eaves double precision, ridge double precision,
  z_eaves double precision, z_ridge double precision, h_max double precision, h_mean double precision,
  h_p50 double precision, h_p90 double precision, area_m2 double precision, volume_m3 double precision, parts bigint,
  flat_share double precision, area3d_share double precision, adaptive_share double precision,
  probability double precision, building_id bigint, attributes json, geometry geometry
)
LANGUAGE sql STABLE AS $$
SELECT v.version_id, v.uid, v.valid_from, v.valid_to, v.source, s.name AS survey, COALESCE(o.state, v.state) AS state,
       v.state AS found_state, o.operator, o.note, v.storeys, v.storeys_min, v.storeys_max, v.storeys_top, v.z_ground,
       v.eaves, v.ridge, v.z_eaves, v.z_ridge, v.h_max, v.h_mean, v.h_p50, v.h_p90, v.area_m2, v.volume_m3,
       v.parts, v.flat_share, v.area3d_share, v.adaptive_share, v.probability, v.building_id,
       COALESCE(v.attributes, '{}') AS attributes,
       v.geometry
FROM building_version AS v
LEFT JOIN survey AS s ON s.survey_id = v.survey_id
LEFT JOIN operator_state AS o ON o.uid = v.uid
WHERE v.valid_from <= to_char(day, 'YYYY-MM-DD')
  AND (v.valid_to IS NULL OR v.valid_to > to_char(day, 'YYYY-MM-DD'))
$$;

COMMENT ON TABLE inventory_building IS 'A building of the inventory, with one identity over all surveys';

COMMENT ON COLUMN inventory_building.uid IS 'from the survey or import that first had it, and its place';

COMMENT ON COLUMN inventory_building.source IS 'name of the survey or import that first had it';

COMMENT ON COLUMN inventory_building.row_digest IS 'digest of the row''s values, which detects edits by other programs';

COMMENT ON TABLE operator_state IS 'An operator''s decision on a building; it has priority over the detectors, also after builds and updates';

COMMENT ON COLUMN operator_state.uid IS 'the building of the inventory';

COMMENT ON COLUMN operator_state.state IS 'confirmed or refuted';

COMMENT ON COLUMN operator_state.operator IS 'who decided';

COMMENT ON COLUMN operator_state.note IS 'the reason; may be empty';

COMMENT ON COLUMN operator_state.decided_at IS 'when, UTC, ISO 8601; not part of the content';

COMMENT ON COLUMN operator_state.row_digest IS 'digest of the row''s values, which detects edits by other programs';

COMMENT ON TABLE roof_sample IS 'A place where the material of a roof is known (V53)';

COMMENT ON COLUMN roof_sample.sample_id IS 'from the place';

COMMENT ON COLUMN roof_sample.material IS 'the material';

COMMENT ON COLUMN roof_sample.note IS 'a remark; may be empty';

COMMENT ON COLUMN roof_sample.attributes IS 'the other columns of the source file; an empty object for none';

COMMENT ON COLUMN roof_sample.geometry IS 'in the database''s CRS [m]';

COMMENT ON COLUMN roof_sample.row_digest IS 'digest of the row''s values, which detects edits by other programs';

COMMENT ON TABLE survey IS 'A survey: where and when the data were taken';

COMMENT ON COLUMN survey.survey_id IS 'from the name';

COMMENT ON COLUMN survey.name IS 'name of the survey';

COMMENT ON COLUMN survey.date IS 'day of the survey, ISO 8601; empty where unknown';

COMMENT ON COLUMN survey.epsg IS 'EPSG code of the horizontal CRS; 0 for a CRS without code';

COMMENT ON COLUMN survey.crs_wkt IS 'the full CRS as WKT';

COMMENT ON COLUMN survey.vertical_crs IS 'the vertical CRS; empty where unknown';

COMMENT ON COLUMN survey.density IS 'first echoes a square metre; 0 for rasters [1/m2]';

COMMENT ON COLUMN survey.cell_m IS 'side of a cell of the lattice [m]';

COMMENT ON COLUMN survey.west IS 'western edge [m]';

COMMENT ON COLUMN survey.south IS 'southern edge [m]';

COMMENT ON COLUMN survey.east IS 'eastern edge [m]';

COMMENT ON COLUMN survey.north IS 'northern edge [m]';

COMMENT ON TABLE tile IS 'A tile of a survey that is built in tiles: how far it is; its result waits here until all tiles are merged';

COMMENT ON COLUMN tile.survey IS 'name of the survey, which may not be built yet';

COMMENT ON COLUMN tile.tile_row IS 'row of the tile, northwards from northing 0';

COMMENT ON COLUMN tile.tile_column IS 'column of the tile, from easting 0';

COMMENT ON COLUMN tile.west IS 'western edge of its own ground [m]';

COMMENT ON COLUMN tile.south IS 'southern edge [m]';

COMMENT ON COLUMN tile.east IS 'eastern edge [m]';

COMMENT ON COLUMN tile.north IS 'northern edge [m]';

COMMENT ON COLUMN tile.state IS 'queued, running, done or failed';

COMMENT ON COLUMN tile.points IS 'points on its own ground [count]';

COMMENT ON COLUMN tile.halo_m IS 'how far it saw beyond [m]';

COMMENT ON COLUMN tile.seconds IS 'time that it took [s]';

COMMENT ON COLUMN tile.reason IS 'why it failed, or has no building; empty otherwise';

COMMENT ON COLUMN tile.build IS 'digest of the files, values and plan of the build that it belongs to';

COMMENT ON COLUMN tile.result IS 'what it found, until it is merged';

COMMENT ON TABLE building_version IS 'A state of a building of the inventory, with the interval in which it is valid';

COMMENT ON COLUMN building_version.version_id IS 'from the building and the survey or import that made it';

COMMENT ON COLUMN building_version.uid IS 'the building';

COMMENT ON COLUMN building_version.valid_from IS 'first day on which it is valid, ISO 8601';

COMMENT ON COLUMN building_version.valid_to IS 'first day on which it is no longer valid, ISO 8601; null for the current version';

COMMENT ON COLUMN building_version.source IS 'what made it: survey or import';

COMMENT ON COLUMN building_version.survey_id IS 'the survey that made it; null for an import';

COMMENT ON COLUMN building_version.closed_by IS 'the survey that ended it; null for the current version';

COMMENT ON COLUMN building_version.building_id IS 'the building of the survey''s run it was copied from, which a rebuild may replace';

COMMENT ON COLUMN building_version.state IS 'confirmed, unsure or refuted: from the probability; where it is null, from the classes and the detectors';

COMMENT ON COLUMN building_version.z_ground IS 'median level of the ground around it, in the survey''s vertical reference; null where not known [m]';

COMMENT ON COLUMN building_version.z_ground_min IS 'lowest level of the ground around it, but for a twentieth [m]';

COMMENT ON COLUMN building_version.z_ground_max IS 'highest level of the ground around it, but for a twentieth [m]';

COMMENT ON COLUMN building_version.z_eaves IS 'level of the eaves of its main roof; null where z_ground is [m]';

COMMENT ON COLUMN building_version.z_ridge IS 'level of the ridge of its highest roof of weight; null where z_ground is [m]';

COMMENT ON COLUMN building_version.eaves IS 'z_eaves above z_ground [m]';

COMMENT ON COLUMN building_version.ridge IS 'z_ridge above z_ground [m]';

COMMENT ON COLUMN building_version.storeys IS 'storeys from the eaves; of runs of an older msbdb, of its tallest part [storeys]';

COMMENT ON COLUMN building_version.storeys_min IS 'fewest storeys that the eaves can have, if storeys are tall [storeys]';

COMMENT ON COLUMN building_version.storeys_max IS 'most storeys that the eaves can have, if storeys are low [storeys]';

COMMENT ON COLUMN building_version.storeys_top IS 'storeys of the highest eaves of its roofs of weight, as of a tower on a podium [storeys]';

COMMENT ON COLUMN building_version.h_max IS 'largest height above ground [m]';

COMMENT ON COLUMN building_version.h_mean IS 'mean height above ground [m]';

COMMENT ON COLUMN building_version.h_p50 IS 'median height above ground [m]';

COMMENT ON COLUMN building_version.h_p90 IS '90th percentile of the height above ground [m]';

COMMENT ON COLUMN building_version.area_m2 IS 'area of the footprint [m2]';

COMMENT ON COLUMN building_version.volume_m3 IS 'sum over the footprint''s cells of height times cell area [m3]';

COMMENT ON COLUMN building_version.parts IS 'number of parts, the roots included [count]';

COMMENT ON COLUMN building_version.flat_share IS 'share of the footprint that flat regions cover; null when this detector was not run [1]';

COMMENT ON COLUMN building_version.area3d_share IS 'share of the footprint that candidates of area3d cover; null when this detector was not run [1]';

COMMENT ON COLUMN building_version.adaptive_share IS 'share of the footprint that candidates of adaptive cover; null when this detector was not run [1]';

COMMENT ON COLUMN building_version.probability IS 'probability that it is a building, from the support of all detectors; null with fewer than three [1]';

COMMENT ON COLUMN building_version.attributes IS 'attributes from an imported inventory, by the names of its columns';

COMMENT ON COLUMN building_version.geometry IS 'in the database''s CRS [m]';

COMMENT ON COLUMN building_version.row_digest IS 'digest of the row''s values, which detects edits by other programs';

COMMENT ON TABLE inventory_event IS 'An import into the inventory or an update of it, with its order and area';

COMMENT ON COLUMN inventory_event.number IS '1 to n, in the order in which they were applied';

COMMENT ON COLUMN inventory_event.kind IS 'import or update';

COMMENT ON COLUMN inventory_event.name IS 'name of the survey or import';

COMMENT ON COLUMN inventory_event.date IS 'first day on which its versions are valid, ISO 8601';

COMMENT ON COLUMN inventory_event.survey_id IS 'the survey; null for an import';

COMMENT ON COLUMN inventory_event.counts IS 'rows that it wrote: changes by kind, and versions';

COMMENT ON COLUMN inventory_event.content_sha256 IS 'digest of everything that determines its result';

COMMENT ON COLUMN inventory_event.geometry IS 'in the database''s CRS [m]';

COMMENT ON COLUMN inventory_event.row_digest IS 'digest of the row''s values, which detects edits by other programs';

COMMENT ON TABLE run IS 'The run that built a survey; a survey has one run, written completely or not at all';

COMMENT ON COLUMN run.run_id IS 'from the survey''s name';

COMMENT ON COLUMN run.survey_id IS 'the survey';

COMMENT ON COLUMN run.profile IS 'the profile: the named set of parameters that it started from';

COMMENT ON COLUMN run.version IS 'version of msbdb';

COMMENT ON COLUMN run.parameters IS 'every parameter''s value, by section';

COMMENT ON COLUMN run.counts IS 'how many regions came in, were kept and dropped';

COMMENT ON COLUMN run.timings IS 'seconds of each stage; not part of the content [s]';

COMMENT ON COLUMN run.notices IS 'warnings and remarks for people, in sentences';

COMMENT ON COLUMN run.content_sha256 IS 'digest of all content of the run except its timings';

COMMENT ON TABLE source IS 'An input file of a survey';

COMMENT ON COLUMN source.survey_id IS 'the survey';

COMMENT ON COLUMN source.number IS '1 to n, in the order of role, name and checksum';

COMMENT ON COLUMN source.name IS 'name of the file';

COMMENT ON COLUMN source.role IS 'what the file provides: points, ortho, dsm, dtm, ndsm, parcels, aoi';

COMMENT ON COLUMN source.sha256 IS 'checksum of the file';

COMMENT ON COLUMN source.bytes IS 'size of the file [bytes]';

COMMENT ON TABLE survey_offset IS 'The offset of a survey: a place (x, y, h) of the inventory is (x + dx, y + dy, h + dz) in the survey';

COMMENT ON COLUMN survey_offset.survey_id IS 'the survey';

COMMENT ON COLUMN survey_offset.dx_m IS 'to the east; 0 where too few buildings match [m]';

COMMENT ON COLUMN survey_offset.dy_m IS 'to the north [m]';

COMMENT ON COLUMN survey_offset.dz_m IS 'of the heights above ground [m]';

COMMENT ON COLUMN survey_offset.pairs IS 'pairs of matching buildings that it was computed from';

COMMENT ON COLUMN survey_offset.spread_m IS 'robust standard deviation of a pair''s shift; null without pairs [m]';

COMMENT ON COLUMN survey_offset.row_digest IS 'digest of the row''s values, which detects edits by other programs';

COMMENT ON TABLE building_change IS 'The change of a building of the inventory in a survey; for merged and split, a row for each pair of buildings';

COMMENT ON COLUMN building_change.change_id IS 'from the survey, the kind and the two buildings';

COMMENT ON COLUMN building_change.survey_id IS 'the survey';

COMMENT ON COLUMN building_change.kind IS 'unchanged, modified, new, demolished, merged or split';

COMMENT ON COLUMN building_change.uid_before IS 'the building before; null for new';

COMMENT ON COLUMN building_change.uid_after IS 'the building after; null when demolished';

COMMENT ON COLUMN building_change.version_before IS 'its version before';

COMMENT ON COLUMN building_change.version_after IS 'its version after; the same as before where unchanged';

COMMENT ON COLUMN building_change.outline IS 'its outline changed';

COMMENT ON COLUMN building_change.height IS 'its height changed';

COMMENT ON COLUMN building_change.parts IS 'only a part of it changed its height';

COMMENT ON COLUMN building_change.overlap_m2 IS 'area shared by both footprints, the inventory shifted by the offset [m2]';

COMMENT ON COLUMN building_change.iou IS 'shared area over the area of the union [1]';

COMMENT ON COLUMN building_change.dh_m IS 'median change of height where both are known [m]';

COMMENT ON COLUMN building_change.darea_m2 IS 'change of the footprint''s area; all of it for new and demolished [m2]';

COMMENT ON COLUMN building_change.note IS 'a remark; often empty';

COMMENT ON COLUMN building_change.row_digest IS 'digest of the row''s values, which detects edits by other programs';

COMMENT ON TABLE candidate_region IS 'A region that a detector on the points takes for a roof';

COMMENT ON COLUMN candidate_region.candidate_id IS 'id of the region, from survey, method and absolute lattice position';

COMMENT ON COLUMN candidate_region.run_id IS 'the run that made the row';

COMMENT ON COLUMN candidate_region.method IS 'area3d (Cao & Wu) or adaptive (Bathurst slides)';

COMMENT ON COLUMN candidate_region.rule IS 'the rule that accepted it: rule 1 or rule 2 (C18); clustering (S6)';

COMMENT ON COLUMN candidate_region.height_scale_m IS 'h_j: lowest height above ground at which it was accepted (C14); null for the adaptive filter [m]';

COMMENT ON COLUMN candidate_region.points IS 'number of its points (C3) [count]';

COMMENT ON COLUMN candidate_region.area_m2 IS 'its points'' area: number over local density (A17) [m2]';

COMMENT ON COLUMN candidate_region.perimeter IS 'number of its edge points (C10); 0 where edges were not computed [count]';

COMMENT ON COLUMN candidate_region.mbr_m2 IS 'area of the minimum bounding rectangle of its points (C10) [m2]';

COMMENT ON COLUMN candidate_region.rectangularity IS 'area over the area of the bounding rectangle (C17) [1]';

COMMENT ON COLUMN candidate_region.compactness IS 'points over edge points (C17); null where edges were not computed [1]';

COMMENT ON COLUMN candidate_region.linearity IS 'mean L(u) over its edge points (C11, C12); null where edges were not computed [1]';

COMMENT ON COLUMN candidate_region.direction_1 IS 'strongest main direction, 0 to 180 from east (C11) [deg]';

COMMENT ON COLUMN candidate_region.direction_2 IS 'second main direction, 0 to 180 from east (C11) [deg]';

COMMENT ON COLUMN candidate_region.ndvi IS 'mean NDVI of its points; null without colours [1]';

COMMENT ON COLUMN candidate_region.h_max IS 'largest height above ground of its points [m]';

COMMENT ON COLUMN candidate_region.h_mean IS 'mean height above ground of its points [m]';

COMMENT ON COLUMN candidate_region.h_p50 IS 'median height above ground of its points [m]';

COMMENT ON COLUMN candidate_region.h_p90 IS '90th percentile of the height above ground of its points [m]';

COMMENT ON COLUMN candidate_region.h_std IS 'standard deviation of the heights of its points [m]';

COMMENT ON COLUMN candidate_region.xcen IS 'easting of the centroid of its points [m]';

COMMENT ON COLUMN candidate_region.ycen IS 'northing of the centroid of its points [m]';

COMMENT ON COLUMN candidate_region.geometry IS 'in the database''s CRS [m]';

COMMENT ON TABLE flat_region IS 'A region of even height above its surroundings, found by its gradients';

COMMENT ON COLUMN flat_region.region_id IS 'id of the flat region, from survey and absolute lattice position; above 0';

COMMENT ON COLUMN flat_region.run_id IS 'the run that made the row';

COMMENT ON COLUMN flat_region.zone IS 'i: attribute-zone of most of its cells; 0 where none has one (Mongus et al. 2013, Eq. 2)';

COMMENT ON COLUMN flat_region.lambda_low_m2 IS 'λ_{i-1}: lower threshold of the zone [m2]';

COMMENT ON COLUMN flat_region.lambda_m2 IS 'λ_i: upper threshold of the zone [m2]';

COMMENT ON COLUMN flat_region.gradient_sum IS 'Λ: sum of second-order gradients times cell area (Eq. 11) [m3]';

COMMENT ON COLUMN flat_region.mean_gradient IS 'mean second-order gradient of its cells, as summed [m]';

COMMENT ON COLUMN flat_region.area_m2 IS 'area of its cells [m2]';

COMMENT ON COLUMN flat_region.perimeter_m IS 'P: corrected length of its outlines, holes included [m]';

COMMENT ON COLUMN flat_region.compactness IS 'Ψ'' = P²/(4πA), 1 for a disc, larger for longer shapes (Eq. 15) [1]';

COMMENT ON COLUMN flat_region.h_max IS 'largest height above ground inside [m]';

COMMENT ON COLUMN flat_region.h_mean IS 'mean height above ground inside [m]';

COMMENT ON COLUMN flat_region.h_p50 IS 'median height above ground inside [m]';

COMMENT ON COLUMN flat_region.h_p90 IS '90th percentile of the height above ground inside [m]';

COMMENT ON COLUMN flat_region.h_std IS 'standard deviation of the heights inside [m]';

COMMENT ON COLUMN flat_region.xcen IS 'easting of the centroid of its cells [m]';

COMMENT ON COLUMN flat_region.ycen IS 'northing of the centroid of its cells [m]';

COMMENT ON COLUMN flat_region.geometry IS 'in the database''s CRS [m]';

COMMENT ON TABLE raster_tile IS 'A tile''s piece of a named raster of a run that was built in tiles; together they are a raster as in run_state';

COMMENT ON COLUMN raster_tile.run_id IS 'the run that made the row';

COMMENT ON COLUMN raster_tile.name IS 'name of the raster';

COMMENT ON COLUMN raster_tile.lattice_row IS 'row of its first cell, southwards from northing 0 [cells]';

COMMENT ON COLUMN raster_tile.lattice_column IS 'column of its first cell, from easting 0 [cells]';

COMMENT ON COLUMN raster_tile.dtype IS 'numpy dtype of the cells, with byte order';

COMMENT ON COLUMN raster_tile.shape IS 'lengths of the axes [cells]';

COMMENT ON COLUMN raster_tile.data IS 'the cells in C order, packed as in msbdb.database.runs.packing';

COMMENT ON TABLE rejection IS 'The ledger: a region that could have been a building by its area, but that a stage dropped, and the reason';

COMMENT ON COLUMN rejection.rejection_id IS 'from the run, the region, the method, the stage and the reason';

COMMENT ON COLUMN rejection.run_id IS 'the run that made the row';

COMMENT ON COLUMN rejection.region_id IS 'id of the dropped region, of the same kind as a part''s';

COMMENT ON COLUMN rejection.method IS 'the detector that dropped it: multiscale, flatregions, area3d or adaptive';

COMMENT ON COLUMN rejection.stage IS 'the stage of the method that dropped it';

COMMENT ON COLUMN rejection.reason IS 'why it was dropped';

COMMENT ON COLUMN rejection.scale IS 'its scale; 0 where none applies';

COMMENT ON COLUMN rejection.area_m2 IS 'its area [m2]';

COMMENT ON COLUMN rejection.xcen IS 'easting of its centroid [m]';

COMMENT ON COLUMN rejection.ycen IS 'northing of its centroid [m]';

COMMENT ON COLUMN rejection.geometry IS 'in the database''s CRS [m]';

COMMENT ON TABLE rejection_count IS 'The ledger in numbers: the regions that a detector dropped at a stage for a reason, those without a row included';

COMMENT ON COLUMN rejection_count.run_id IS 'the run that made the row';

COMMENT ON COLUMN rejection_count.method IS 'the detector: multiscale, flatregions, area3d or adaptive';

COMMENT ON COLUMN rejection_count.number IS 'number of the stage and reason among those of the detector, from 1; the value in its raster of answers';

COMMENT ON COLUMN rejection_count.stage IS 'the stage that dropped them';

COMMENT ON COLUMN rejection_count.reason IS 'why they were dropped';

COMMENT ON COLUMN rejection_count.regions IS 'number of the dropped regions [count]';

COMMENT ON COLUMN rejection_count.area_m2 IS 'their area [m2]';

COMMENT ON COLUMN rejection_count.small IS 'number of those smaller than the least building area, which have no row in rejection [count]';

COMMENT ON COLUMN rejection_count.small_m2 IS 'the area of these [m2]';

COMMENT ON TABLE run_method IS 'A detector of a run';

COMMENT ON COLUMN run_method.run_id IS 'the run that made the row';

COMMENT ON COLUMN run_method.method IS 'multiscale, flatregions, area3d or adaptive';

COMMENT ON TABLE run_state IS 'A named raster of a run, by which classes can be labelled again without the source data';

COMMENT ON COLUMN run_state.run_id IS 'the run that made the row';

COMMENT ON COLUMN run_state.name IS 'name of the raster';

COMMENT ON COLUMN run_state.dtype IS 'numpy dtype of the cells, with byte order';

COMMENT ON COLUMN run_state.shape IS 'lengths of the axes [cells]';

COMMENT ON COLUMN run_state.data IS 'the cells in C order, packed as in msbdb.database.runs.packing';

COMMENT ON TABLE scale IS 'A scale of a run''s scale-space';

COMMENT ON COLUMN scale.run_id IS 'the run that made the row';

COMMENT ON COLUMN scale.scale IS 'SCALE: number of the scale, 1 = coarsest';

COMMENT ON COLUMN scale.threshold_px IS 's: area threshold of opening and closing (Vu et al. 2009, Eq. 6) [cells]';

COMMENT ON COLUMN scale.threshold_m2 IS 's in square metres [m2]';

COMMENT ON TABLE spectral_class IS 'A class of land cover of a run';

COMMENT ON COLUMN spectral_class.run_id IS 'the run that made the row';

COMMENT ON COLUMN spectral_class.speindex IS 'SPE: number of the class, from 1 in canonical order';

COMMENT ON COLUMN spectral_class.label IS 'building, vegetation, shadow, water or other';

COMMENT ON COLUMN spectral_class.labelled_by IS 'automatic or operator';

COMMENT ON COLUMN spectral_class.source IS 'spectral: k-means on the bands; structure: height texture and echoes';

COMMENT ON COLUMN spectral_class.cells IS 'number of cells of the class [cells]';

COMMENT ON COLUMN spectral_class.share IS 'share of all classified cells [1]';

COMMENT ON COLUMN spectral_class.ndvi IS 'mean of (NIR - red) / (NIR + red), or of its substitute; null without bands [1]';

COMMENT ON COLUMN spectral_class.brightness IS 'mean over all bands of the values scaled to 0 to 1; null without imagery [1]';

COMMENT ON COLUMN spectral_class.roughness_m IS 'median local roughness of the surface; null where unknown [m]';

COMMENT ON COLUMN spectral_class.height_m IS 'mean height above ground [m]';

COMMENT ON TABLE survey_plan IS 'The plan by which a run was built: values that hold for the whole survey, and for each tile of it';

COMMENT ON COLUMN survey_plan.run_id IS 'the run that made the row';

COMMENT ON COLUMN survey_plan.plan IS 'the plan, as msbdb plan --json shows it';

COMMENT ON TABLE building IS 'A building: one connected island of roofs that the detectors support, with one or more trees of parts';

COMMENT ON COLUMN building.building_id IS 'stable id of the building: the ID of its largest root';

COMMENT ON COLUMN building.run_id IS 'the run that made the row';

COMMENT ON COLUMN building.state IS 'confirmed, unsure or refuted: from the probability; where it is null, from the classes and the detectors';

COMMENT ON COLUMN building.probability IS 'probability that it is a building, from the support of all detectors; null with fewer than three [1]';

COMMENT ON COLUMN building.z_ground IS 'median level of the ground around it, in the survey''s vertical reference; null where not known [m]';

COMMENT ON COLUMN building.z_ground_min IS 'lowest level of the ground around it, but for a twentieth [m]';

COMMENT ON COLUMN building.z_ground_max IS 'highest level of the ground around it, but for a twentieth [m]';

COMMENT ON COLUMN building.z_eaves IS 'level of the eaves of its main roof; null where z_ground is [m]';

COMMENT ON COLUMN building.z_ridge IS 'level of the ridge of its highest roof of weight; null where z_ground is [m]';

COMMENT ON COLUMN building.eaves IS 'z_eaves above z_ground [m]';

COMMENT ON COLUMN building.ridge IS 'z_ridge above z_ground [m]';

COMMENT ON COLUMN building.storeys IS 'storeys from the eaves; of runs of an older msbdb, of its tallest part [storeys]';

COMMENT ON COLUMN building.storeys_min IS 'fewest storeys that the eaves can have, if storeys are tall [storeys]';

COMMENT ON COLUMN building.storeys_max IS 'most storeys that the eaves can have, if storeys are low [storeys]';

COMMENT ON COLUMN building.storeys_top IS 'storeys of the highest eaves of its roofs of weight, as of a tower on a podium [storeys]';

COMMENT ON COLUMN building.h_max IS 'largest height above ground [m]';

COMMENT ON COLUMN building.h_mean IS 'mean height above ground [m]';

COMMENT ON COLUMN building.h_p50 IS 'median height above ground [m]';

COMMENT ON COLUMN building.h_p90 IS '90th percentile of the height above ground [m]';

COMMENT ON COLUMN building.area_m2 IS 'area of the footprint''s cells [m2]';

COMMENT ON COLUMN building.volume_m3 IS 'sum over the footprint''s cells of height times cell area [m3]';

COMMENT ON COLUMN building.floor_area_m2 IS 'estimate of the area of all storeys, by the eaves of each roof; null in runs of an older msbdb [m2]';

COMMENT ON COLUMN building.trees IS 'number of its trees of parts; one root each [count]';

COMMENT ON COLUMN building.parts IS 'number of parts, the roots included [count]';

COMMENT ON COLUMN building.scales IS 'number of scales on which it has parts [count]';

COMMENT ON COLUMN building.speindex IS 'the spectral class of its largest root; 0 for none';

COMMENT ON COLUMN building.class_id IS 'SPE, but null for none';

COMMENT ON COLUMN building.building_share IS 'share of its cells whose class is a building class [1]';

COMMENT ON COLUMN building.xcen IS 'easting of the centroid of its cells [m]';

COMMENT ON COLUMN building.ycen IS 'northing of the centroid of its cells [m]';

COMMENT ON COLUMN building.xin IS 'easting of a point that lies on the building [m]';

COMMENT ON COLUMN building.yin IS 'northing of a point that lies on the building [m]';

COMMENT ON COLUMN building.multiscale_share IS 'share of the footprint that regions of multiscale cover; null when this detector was not run [1]';

COMMENT ON COLUMN building.flat_share IS 'share of the footprint that flat regions cover; null when this detector was not run [1]';

COMMENT ON COLUMN building.area3d_share IS 'share of the footprint that candidates of area3d cover; null when this detector was not run [1]';

COMMENT ON COLUMN building.adaptive_share IS 'share of the footprint that candidates of adaptive cover; null when this detector was not run [1]';

COMMENT ON COLUMN building.coverage IS 'share of the footprint''s cells with a measured height [1]';

COMMENT ON COLUMN building.nodata_share IS 'share of the footprint and the ring around it that has no height, as at water and at the survey''s border [1]';

COMMENT ON COLUMN building.density IS 'first echoes a square metre in it; null for rasters [1/m2]';

COMMENT ON COLUMN building.divided_by IS 'why touching houses beside it are other buildings: parcel, step, valley, wall, direction, material; several with commas; empty for none';

COMMENT ON COLUMN building.outline_source IS 'the outline, of roof edges: fitted to straight walls, or traced along cells where some wall would be off';

COMMENT ON COLUMN building.geometry IS 'in the database''s CRS [m]';

COMMENT ON TABLE flat_region_candidate IS 'A flat region and a candidate region that share cells: each is evidence for the other';

COMMENT ON COLUMN flat_region_candidate.region_id IS 'the flat region';

COMMENT ON COLUMN flat_region_candidate.candidate_id IS 'the candidate region that it shares cells with';

COMMENT ON COLUMN flat_region_candidate.run_id IS 'the run that made the row';

COMMENT ON COLUMN flat_region_candidate.overlap_m2 IS 'area of the cells that both cover; above 0 [m2]';

COMMENT ON COLUMN flat_region_candidate.region_share IS 'share of the flat region''s area that the candidate region covers [1]';

COMMENT ON COLUMN flat_region_candidate.candidate_share IS 'share of the candidate region''s cells that the flat region covers [1]';

COMMENT ON TABLE spectral_class_band IS 'The mean of a band in a class';

COMMENT ON COLUMN spectral_class_band.run_id IS 'the run that made the row';

COMMENT ON COLUMN spectral_class_band.speindex IS 'the class';

COMMENT ON COLUMN spectral_class_band.band IS 'name of the band';

COMMENT ON COLUMN spectral_class_band.mean IS 'mean value of the band in the class, in the source''s units [DN]';

COMMENT ON TABLE part IS 'A part of a building on one scale; a father holds its children (V32, V33)';

COMMENT ON COLUMN part.part_id IS 'ID: from survey, scale and absolute lattice position; above 0';

COMMENT ON COLUMN part.run_id IS 'the run that made the row';

COMMENT ON COLUMN part.supid IS 'SUPID: the father''s ID; 0 for a root';

COMMENT ON COLUMN part.father_id IS 'SUPID, but null for a root';

COMMENT ON COLUMN part.supscale IS 'SUPSCALE: the father''s scale; 0 for a root';

COMMENT ON COLUMN part.root_id IS 'ID of the root of its tree';

COMMENT ON COLUMN part.building_id IS 'the building in which its tree stands';

COMMENT ON COLUMN part.scale IS 'SCALE: the scale on which the part exists, 1 = coarsest';

COMMENT ON COLUMN part.hindex IS 'H: storeys from h_p90, or with surface.storeys_from=zone the same as hzone (V18, V30) [storeys]';

COMMENT ON COLUMN part.hzone IS 'H by the letter of the paper: the value of the flat zone [slices]';

COMMENT ON COLUMN part.speindex IS 'SPE: the most frequent spectral class inside; 0 for none';

COMMENT ON COLUMN part.class_id IS 'SPE, but null for none';

COMMENT ON COLUMN part.xo IS 'XO: easting of the first cell in row order [m]';

COMMENT ON COLUMN part.yo IS 'YO: northing of the first cell in row order [m]';

COMMENT ON COLUMN part.xcen IS 'XCEN: easting of the centroid of its cells [m]';

COMMENT ON COLUMN part.ycen IS 'YCEN: northing of the centroid of its cells [m]';

COMMENT ON COLUMN part.xin IS 'easting of a point that lies on the part [m]';

COMMENT ON COLUMN part.yin IS 'northing of a point that lies on the part [m]';

COMMENT ON COLUMN part.area_px IS 'number of cells [cells]';

COMMENT ON COLUMN part.area_m2 IS 'AREA: area of the cells [m2]';

COMMENT ON COLUMN part.stddis IS 'STDDIS: std of the children''s distances to the centre; null without children [m]';

COMMENT ON COLUMN part.h_max IS 'largest height above ground inside [m]';

COMMENT ON COLUMN part.h_mean IS 'mean height above ground inside [m]';

COMMENT ON COLUMN part.h_p50 IS 'median height above ground inside [m]';

COMMENT ON COLUMN part.h_p90 IS '90th percentile of the height above ground inside [m]';

COMMENT ON COLUMN part.h_std IS 'standard deviation of the heights inside [m]';

COMMENT ON COLUMN part.building_share IS 'share of its cells whose class is a building class [1]';

COMMENT ON COLUMN part.outline_source IS 'the outline, of roof edges: fitted to straight walls, or traced along cells where some wall would be off';

COMMENT ON COLUMN part.geometry IS 'in the database''s CRS [m]';

COMMENT ON TABLE part_candidate IS 'A part and a candidate region that share cells: each is evidence for the other';

COMMENT ON COLUMN part_candidate.part_id IS 'the part';

COMMENT ON COLUMN part_candidate.candidate_id IS 'the candidate region that it shares cells with';

COMMENT ON COLUMN part_candidate.run_id IS 'the run that made the row';

COMMENT ON COLUMN part_candidate.overlap_m2 IS 'area of the cells that both cover; above 0 [m2]';

COMMENT ON COLUMN part_candidate.part_share IS 'share of the part''s area that the candidate region covers [1]';

COMMENT ON COLUMN part_candidate.candidate_share IS 'share of the candidate region''s cells that the part covers [1]';

COMMENT ON TABLE part_flat_region IS 'A part and a flat region that share cells: each is evidence for the other';

COMMENT ON COLUMN part_flat_region.part_id IS 'the part';

COMMENT ON COLUMN part_flat_region.region_id IS 'the flat region that it shares cells with';

COMMENT ON COLUMN part_flat_region.run_id IS 'the run that made the row';

COMMENT ON COLUMN part_flat_region.overlap_m2 IS 'area of the cells that both cover; above 0 [m2]';

COMMENT ON COLUMN part_flat_region.part_share IS 'share of the part''s area that the region covers [1]';

COMMENT ON COLUMN part_flat_region.region_share IS 'share of the region''s area that the part covers [1]';

COMMENT ON VIEW footprint IS 'The footprints: a row for each building, with its state, its probability, its heights and its outline of roof edges. Levels z_ are in the survey''s vertical reference; eaves and ridge are above z_ground.';

COMMENT ON COLUMN footprint.building_id IS 'stable id of the building: the ID of its largest root';

COMMENT ON COLUMN footprint.survey IS 'name of the survey';

COMMENT ON COLUMN footprint.state IS 'confirmed, unsure or refuted: from the probability; where it is null, from the classes and the detectors';

COMMENT ON COLUMN footprint.probability IS 'probability that it is a building, from the support of all detectors; null with fewer than three [1]';

COMMENT ON COLUMN footprint.storeys IS 'storeys from the eaves; of runs of an older msbdb, of its tallest part [storeys]';

COMMENT ON COLUMN footprint.storeys_min IS 'fewest storeys that the eaves can have, if storeys are tall [storeys]';

COMMENT ON COLUMN footprint.storeys_max IS 'most storeys that the eaves can have, if storeys are low [storeys]';

COMMENT ON COLUMN footprint.storeys_top IS 'storeys of the highest eaves of its roofs of weight, as of a tower on a podium [storeys]';

COMMENT ON COLUMN footprint.z_ground IS 'median level of the ground around it, in the survey''s vertical reference; null where not known [m]';

COMMENT ON COLUMN footprint.eaves IS 'z_eaves above z_ground [m]';

COMMENT ON COLUMN footprint.ridge IS 'z_ridge above z_ground [m]';

COMMENT ON COLUMN footprint.z_eaves IS 'level of the eaves of its main roof; null where z_ground is [m]';

COMMENT ON COLUMN footprint.z_ridge IS 'level of the ridge of its highest roof of weight; null where z_ground is [m]';

COMMENT ON COLUMN footprint.speindex IS 'the spectral class of its largest root; 0 for none';

COMMENT ON COLUMN footprint.area_m2 IS 'area of the footprint''s cells [m2]';

COMMENT ON COLUMN footprint.h_max IS 'largest height above ground [m]';

COMMENT ON COLUMN footprint.h_mean IS 'mean height above ground [m]';

COMMENT ON COLUMN footprint.h_p50 IS 'median height above ground [m]';

COMMENT ON COLUMN footprint.h_p90 IS '90th percentile of the height above ground [m]';

COMMENT ON COLUMN footprint.trees IS 'number of its trees of parts; one root each [count]';

COMMENT ON COLUMN footprint.parts IS 'number of parts, the roots included [count]';

COMMENT ON COLUMN footprint.divided_by IS 'why touching houses beside it are other buildings: parcel, step, valley, wall, direction, material; several with commas; empty for none';

COMMENT ON COLUMN footprint.outline_source IS 'the outline, of roof edges: fitted to straight walls, or traced along cells where some wall would be off';

COMMENT ON COLUMN footprint.xin IS 'easting of a point that lies on the building [m]';

COMMENT ON COLUMN footprint.yin IS 'northing of a point that lies on the building [m]';

COMMENT ON COLUMN footprint.geometry IS 'outline of the roof''s edges, in the database''s CRS';

COMMENT ON VIEW part_tree IS 'The parts as trees: the depth below the root, and the path of ids from the root down.';

COMMENT ON COLUMN part_tree.part_id IS 'ID: from survey, scale and absolute lattice position; above 0';

COMMENT ON COLUMN part_tree.survey IS 'name of the survey';

COMMENT ON COLUMN part_tree.building_id IS 'the building in which its tree stands';

COMMENT ON COLUMN part_tree.root_id IS 'ID of the root of its tree';

COMMENT ON COLUMN part_tree.supid IS 'SUPID: the father''s ID; 0 for a root';

COMMENT ON COLUMN part_tree.supscale IS 'SUPSCALE: the father''s scale; 0 for a root';

COMMENT ON COLUMN part_tree.scale IS 'SCALE: the scale on which the part exists, 1 = coarsest';

COMMENT ON COLUMN part_tree.depth IS 'number of fathers above the part; 0 for a root';

COMMENT ON COLUMN part_tree.path IS 'ids from the root down to the part, with / between them';

COMMENT ON COLUMN part_tree.hindex IS 'H: storeys from h_p90, or with surface.storeys_from=zone the same as hzone (V18, V30) [storeys]';

COMMENT ON COLUMN part_tree.speindex IS 'SPE: the most frequent spectral class inside; 0 for none';

COMMENT ON COLUMN part_tree.area_m2 IS 'AREA: area of the cells [m2]';

COMMENT ON COLUMN part_tree.stddis IS 'STDDIS: std of the children''s distances to the centre; null without children [m]';

COMMENT ON COLUMN part_tree.h_max IS 'largest height above ground inside [m]';

COMMENT ON COLUMN part_tree.h_p90 IS '90th percentile of the height above ground inside [m]';

COMMENT ON COLUMN part_tree.outline_source IS 'the outline, of roof edges: fitted to straight walls, or traced along cells where some wall would be off';

COMMENT ON COLUMN part_tree.geometry IS 'outline of the roof''s edges, in the database''s CRS';

COMMENT ON VIEW building_summary IS 'One row for each building, for maps and tables: place, storeys, heights, volume, class, and how well it was seen. Levels z_ are in the vertical reference of the survey, vertical_crs where it is known. floor_area_m2 is an estimate: where a run of an older msbdb has none, each part counts its area once for every storey by which it rises above its father.';

COMMENT ON COLUMN building_summary.building_id IS 'stable id of the building: the ID of its largest root';

COMMENT ON COLUMN building_summary.survey IS 'name of the survey';

COMMENT ON COLUMN building_summary.survey_date IS 'day of the survey, ISO 8601; empty where unknown';

COMMENT ON COLUMN building_summary.state IS 'confirmed, unsure or refuted: from the probability; where it is null, from the classes and the detectors';

COMMENT ON COLUMN building_summary.probability IS 'probability that it is a building, from the support of all detectors; null with fewer than three [1]';

COMMENT ON COLUMN building_summary.storeys IS 'storeys from the eaves; of runs of an older msbdb, of its tallest part [storeys]';

COMMENT ON COLUMN building_summary.storeys_min IS 'fewest storeys that the eaves can have, if storeys are tall [storeys]';

COMMENT ON COLUMN building_summary.storeys_max IS 'most storeys that the eaves can have, if storeys are low [storeys]';

COMMENT ON COLUMN building_summary.storeys_top IS 'storeys of the highest eaves of its roofs of weight, as of a tower on a podium [storeys]';

COMMENT ON COLUMN building_summary.z_ground IS 'median level of the ground around it, in the survey''s vertical reference; null where not known [m]';

COMMENT ON COLUMN building_summary.z_ground_min IS 'lowest level of the ground around it, but for a twentieth [m]';

COMMENT ON COLUMN building_summary.z_ground_max IS 'highest level of the ground around it, but for a twentieth [m]';

COMMENT ON COLUMN building_summary.eaves IS 'z_eaves above z_ground [m]';

COMMENT ON COLUMN building_summary.ridge IS 'z_ridge above z_ground [m]';

COMMENT ON COLUMN building_summary.z_eaves IS 'level of the eaves of its main roof; null where z_ground is [m]';

COMMENT ON COLUMN building_summary.z_ridge IS 'level of the ridge of its highest roof of weight; null where z_ground is [m]';

COMMENT ON COLUMN building_summary.vertical_crs IS 'the vertical CRS; empty where unknown';

COMMENT ON COLUMN building_summary.coverage IS 'share of the footprint''s cells with a measured height [1]';

COMMENT ON COLUMN building_summary.nodata_share IS 'share of the footprint and the ring around it that has no height, as at water and at the survey''s border [1]';

COMMENT ON COLUMN building_summary.density IS 'first echoes a square metre in it; null for rasters [1/m2]';

COMMENT ON COLUMN building_summary.multiscale_share IS 'share of the footprint that regions of multiscale cover; null when this detector was not run [1]';

COMMENT ON COLUMN building_summary.flat_share IS 'share of the footprint that flat regions cover; null when this detector was not run [1]';

COMMENT ON COLUMN building_summary.area3d_share IS 'share of the footprint that candidates of area3d cover; null when this detector was not run [1]';

COMMENT ON COLUMN building_summary.adaptive_share IS 'share of the footprint that candidates of adaptive cover; null when this detector was not run [1]';

COMMENT ON COLUMN building_summary.h_max IS 'largest height above ground [m]';

COMMENT ON COLUMN building_summary.h_mean IS 'mean height above ground [m]';

COMMENT ON COLUMN building_summary.h_p50 IS 'median height above ground [m]';

COMMENT ON COLUMN building_summary.h_p90 IS '90th percentile of the height above ground [m]';

COMMENT ON COLUMN building_summary.area_m2 IS 'area of the footprint''s cells [m2]';

COMMENT ON COLUMN building_summary.volume_m3 IS 'sum over the footprint''s cells of height times cell area [m3]';

COMMENT ON COLUMN building_summary.floor_area_m2 IS 'estimate of the area of all storeys, by the eaves of each roof; null in runs of an older msbdb [m2]';

COMMENT ON COLUMN building_summary.trees IS 'number of its trees of parts; one root each [count]';

COMMENT ON COLUMN building_summary.parts IS 'number of parts, the roots included [count]';

COMMENT ON COLUMN building_summary.scales IS 'number of scales on which it has parts [count]';

COMMENT ON COLUMN building_summary.speindex IS 'the spectral class of its largest root; 0 for none';

COMMENT ON COLUMN building_summary.class_label IS 'building, vegetation, shadow, water or other';

COMMENT ON COLUMN building_summary.divided_by IS 'why touching houses beside it are other buildings: parcel, step, valley, wall, direction, material; several with commas; empty for none';

COMMENT ON COLUMN building_summary.outline_source IS 'the outline, of roof edges: fitted to straight walls, or traced along cells where some wall would be off';

COMMENT ON COLUMN building_summary.xcen IS 'easting of the centroid of its cells [m]';

COMMENT ON COLUMN building_summary.ycen IS 'northing of the centroid of its cells [m]';

COMMENT ON COLUMN building_summary.xin IS 'easting of a point that lies on the building [m]';

COMMENT ON COLUMN building_summary.yin IS 'northing of a point that lies on the building [m]';

COMMENT ON COLUMN building_summary.geometry IS 'outline of the roof''s edges, in the database''s CRS';

COMMENT ON VIEW part_evidence IS 'The parts with evidence from other detectors: the share that flat regions, candidates of area3d and candidates of adaptive cover, and the number of these regions; null for a detector that was not run.';

COMMENT ON COLUMN part_evidence.part_id IS 'ID: from survey, scale and absolute lattice position; above 0';

COMMENT ON COLUMN part_evidence.survey IS 'name of the survey';

COMMENT ON COLUMN part_evidence.building_id IS 'the building in which its tree stands';

COMMENT ON COLUMN part_evidence.root_id IS 'ID of the root of its tree';

COMMENT ON COLUMN part_evidence.supid IS 'SUPID: the father''s ID; 0 for a root';

COMMENT ON COLUMN part_evidence.scale IS 'SCALE: the scale on which the part exists, 1 = coarsest';

COMMENT ON COLUMN part_evidence.hindex IS 'H: storeys from h_p90, or with surface.storeys_from=zone the same as hzone (V18, V30) [storeys]';

COMMENT ON COLUMN part_evidence.area_m2 IS 'AREA: area of the cells [m2]';

COMMENT ON COLUMN part_evidence.building_share IS 'share of its cells whose class is a building class [1]';

COMMENT ON COLUMN part_evidence.flat_share IS 'share of the part that regions of flatregions cover; null when it was not run [1]';

COMMENT ON COLUMN part_evidence.flat_regions IS 'number of regions of flatregions that share cells with the part; null when it was not run [count]';

COMMENT ON COLUMN part_evidence.area3d_share IS 'share of the part that regions of area3d cover; null when it was not run [1]';

COMMENT ON COLUMN part_evidence.area3d_regions IS 'number of regions of area3d that share cells with the part; null when it was not run [count]';

COMMENT ON COLUMN part_evidence.adaptive_share IS 'share of the part that regions of adaptive cover; null when it was not run [1]';

COMMENT ON COLUMN part_evidence.adaptive_regions IS 'number of regions of adaptive that share cells with the part; null when it was not run [count]';

COMMENT ON COLUMN part_evidence.geometry IS 'outline of the roof''s edges, in the database''s CRS';

COMMENT ON VIEW unexplained_flat_region IS 'The flat regions that no part explains: root parts cover less than 0.5 of them; explained_share is that share.';

COMMENT ON COLUMN unexplained_flat_region.region_id IS 'id of the flat region, from survey and absolute lattice position; above 0';

COMMENT ON COLUMN unexplained_flat_region.survey IS 'name of the survey';

COMMENT ON COLUMN unexplained_flat_region.zone IS 'i: attribute-zone of most of its cells; 0 where none has one (Mongus et al. 2013, Eq. 2)';

COMMENT ON COLUMN unexplained_flat_region.lambda_low_m2 IS 'λ_{i-1}: lower threshold of the zone [m2]';

COMMENT ON COLUMN unexplained_flat_region.lambda_m2 IS 'λ_i: upper threshold of the zone [m2]';

COMMENT ON COLUMN unexplained_flat_region.gradient_sum IS 'Λ: sum of second-order gradients times cell area (Eq. 11) [m3]';

COMMENT ON COLUMN unexplained_flat_region.mean_gradient IS 'mean second-order gradient of its cells, as summed [m]';

COMMENT ON COLUMN unexplained_flat_region.area_m2 IS 'area of its cells [m2]';

COMMENT ON COLUMN unexplained_flat_region.perimeter_m IS 'P: corrected length of its outlines, holes included [m]';

COMMENT ON COLUMN unexplained_flat_region.compactness IS 'Ψ'' = P²/(4πA), 1 for a disc, larger for longer shapes (Eq. 15) [1]';

COMMENT ON COLUMN unexplained_flat_region.h_max IS 'largest height above ground inside [m]';

COMMENT ON COLUMN unexplained_flat_region.h_mean IS 'mean height above ground inside [m]';

COMMENT ON COLUMN unexplained_flat_region.h_p50 IS 'median height above ground inside [m]';

COMMENT ON COLUMN unexplained_flat_region.h_p90 IS '90th percentile of the height above ground inside [m]';

COMMENT ON COLUMN unexplained_flat_region.h_std IS 'standard deviation of the heights inside [m]';

COMMENT ON COLUMN unexplained_flat_region.xcen IS 'easting of the centroid of its cells [m]';

COMMENT ON COLUMN unexplained_flat_region.ycen IS 'northing of the centroid of its cells [m]';

COMMENT ON COLUMN unexplained_flat_region.explained_share IS 'share of the region that root parts cover; null when multiscale was not run [1]';

COMMENT ON COLUMN unexplained_flat_region.geometry IS 'outline of the roof''s edges, in the database''s CRS';

COMMENT ON VIEW candidate_evidence IS 'The candidate regions with evidence from other detectors: explained_share is the share that root parts cover, flat_share the share that flat regions cover; null for a detector that was not run.';

COMMENT ON COLUMN candidate_evidence.candidate_id IS 'id of the region, from survey, method and absolute lattice position';

COMMENT ON COLUMN candidate_evidence.survey IS 'name of the survey';

COMMENT ON COLUMN candidate_evidence.method IS 'area3d (Cao & Wu) or adaptive (Bathurst slides)';

COMMENT ON COLUMN candidate_evidence.rule IS 'the rule that accepted it: rule 1 or rule 2 (C18); clustering (S6)';

COMMENT ON COLUMN candidate_evidence.height_scale_m IS 'h_j: lowest height above ground at which it was accepted (C14); null for the adaptive filter [m]';

COMMENT ON COLUMN candidate_evidence.points IS 'number of its points (C3) [count]';

COMMENT ON COLUMN candidate_evidence.area_m2 IS 'its points'' area: number over local density (A17) [m2]';

COMMENT ON COLUMN candidate_evidence.rectangularity IS 'area over the area of the bounding rectangle (C17) [1]';

COMMENT ON COLUMN candidate_evidence.compactness IS 'points over edge points (C17); null where edges were not computed [1]';

COMMENT ON COLUMN candidate_evidence.linearity IS 'mean L(u) over its edge points (C11, C12); null where edges were not computed [1]';

COMMENT ON COLUMN candidate_evidence.ndvi IS 'mean NDVI of its points; null without colours [1]';

COMMENT ON COLUMN candidate_evidence.h_p50 IS 'median height above ground of its points [m]';

COMMENT ON COLUMN candidate_evidence.h_p90 IS '90th percentile of the height above ground of its points [m]';

COMMENT ON COLUMN candidate_evidence.h_std IS 'standard deviation of the heights of its points [m]';

COMMENT ON COLUMN candidate_evidence.xcen IS 'easting of the centroid of its points [m]';

COMMENT ON COLUMN candidate_evidence.ycen IS 'northing of the centroid of its points [m]';

COMMENT ON COLUMN candidate_evidence.explained_share IS 'share of the region that root parts cover; null when multiscale was not run [1]';

COMMENT ON COLUMN candidate_evidence.flat_share IS 'share of the region that flat regions cover; null when they were not looked for [1]';

COMMENT ON COLUMN candidate_evidence.geometry IS 'outline of the roof''s edges, in the database''s CRS';

COMMENT ON VIEW unexplained_candidate IS 'The candidate regions that no part explains: root parts cover less than 0.5 of them; explained_share is the share that they cover.';

COMMENT ON COLUMN unexplained_candidate.candidate_id IS 'id of the region, from survey, method and absolute lattice position';

COMMENT ON COLUMN unexplained_candidate.survey IS 'name of the survey';

COMMENT ON COLUMN unexplained_candidate.method IS 'area3d (Cao & Wu) or adaptive (Bathurst slides)';

COMMENT ON COLUMN unexplained_candidate.rule IS 'the rule that accepted it: rule 1 or rule 2 (C18); clustering (S6)';

COMMENT ON COLUMN unexplained_candidate.height_scale_m IS 'h_j: lowest height above ground at which it was accepted (C14); null for the adaptive filter [m]';

COMMENT ON COLUMN unexplained_candidate.points IS 'number of its points (C3) [count]';

COMMENT ON COLUMN unexplained_candidate.area_m2 IS 'its points'' area: number over local density (A17) [m2]';

COMMENT ON COLUMN unexplained_candidate.rectangularity IS 'area over the area of the bounding rectangle (C17) [1]';

COMMENT ON COLUMN unexplained_candidate.compactness IS 'points over edge points (C17); null where edges were not computed [1]';

COMMENT ON COLUMN unexplained_candidate.linearity IS 'mean L(u) over its edge points (C11, C12); null where edges were not computed [1]';

COMMENT ON COLUMN unexplained_candidate.ndvi IS 'mean NDVI of its points; null without colours [1]';

COMMENT ON COLUMN unexplained_candidate.h_max IS 'largest height above ground of its points [m]';

COMMENT ON COLUMN unexplained_candidate.h_mean IS 'mean height above ground of its points [m]';

COMMENT ON COLUMN unexplained_candidate.h_p50 IS 'median height above ground of its points [m]';

COMMENT ON COLUMN unexplained_candidate.h_p90 IS '90th percentile of the height above ground of its points [m]';

COMMENT ON COLUMN unexplained_candidate.h_std IS 'standard deviation of the heights of its points [m]';

COMMENT ON COLUMN unexplained_candidate.xcen IS 'easting of the centroid of its points [m]';

COMMENT ON COLUMN unexplained_candidate.ycen IS 'northing of the centroid of its points [m]';

COMMENT ON COLUMN unexplained_candidate.explained_share IS 'share of the region that root parts cover; null when multiscale was not run [1]';

COMMENT ON COLUMN unexplained_candidate.geometry IS 'outline of the roof''s edges, in the database''s CRS';

COMMENT ON VIEW building_evidence IS 'The buildings with their evidence: whether the classes confirm each (1 or 0), how many other detectors were run, and how many of these confirm it by covering at least 0.1 of it.';

COMMENT ON COLUMN building_evidence.building_id IS 'stable id of the building: the ID of its largest root';

COMMENT ON COLUMN building_evidence.survey IS 'name of the survey';

COMMENT ON COLUMN building_evidence.state IS 'confirmed, unsure or refuted: from the probability; where it is null, from the classes and the detectors';

COMMENT ON COLUMN building_evidence.probability IS 'probability that it is a building, from the support of all detectors; null with fewer than three [1]';

COMMENT ON COLUMN building_evidence.storeys IS 'storeys from the eaves; of runs of an older msbdb, of its tallest part [storeys]';

COMMENT ON COLUMN building_evidence.h_p90 IS '90th percentile of the height above ground [m]';

COMMENT ON COLUMN building_evidence.area_m2 IS 'area of the footprint''s cells [m2]';

COMMENT ON COLUMN building_evidence.building_share IS 'share of its cells whose class is a building class [1]';

COMMENT ON COLUMN building_evidence.multiscale_share IS 'share of the footprint that regions of multiscale cover; null when this detector was not run [1]';

COMMENT ON COLUMN building_evidence.flat_share IS 'share of the footprint that flat regions cover; null when this detector was not run [1]';

COMMENT ON COLUMN building_evidence.area3d_share IS 'share of the footprint that candidates of area3d cover; null when this detector was not run [1]';

COMMENT ON COLUMN building_evidence.adaptive_share IS 'share of the footprint that candidates of adaptive cover; null when this detector was not run [1]';

COMMENT ON COLUMN building_evidence.classes_for IS '1 where the classes of land cover confirm it, else 0 [count]';

COMMENT ON COLUMN building_evidence.extractors_heard IS 'number of the other detectors that were run [count]';

COMMENT ON COLUMN building_evidence.extractors_for IS 'number of these that confirm it [count]';

COMMENT ON COLUMN building_evidence.geometry IS 'outline of the roof''s edges, in the database''s CRS';

COMMENT ON VIEW footprint_current IS 'The present inventory: the current version of each building. An operator''s decision has priority over the detected state (found_state).';

COMMENT ON COLUMN footprint_current.version_id IS 'from the building and the survey or import that made it';

COMMENT ON COLUMN footprint_current.uid IS 'the building';

COMMENT ON COLUMN footprint_current.valid_from IS 'first day on which it is valid, ISO 8601';

COMMENT ON COLUMN footprint_current.valid_to IS 'first day on which it is no longer valid, ISO 8601; null for the current version';

COMMENT ON COLUMN footprint_current.source IS 'what made it: survey or import';

COMMENT ON COLUMN footprint_current.survey IS 'name of the survey';

COMMENT ON COLUMN footprint_current.state IS 'confirmed, unsure or refuted: the operator''s decision, else found_state';

COMMENT ON COLUMN footprint_current.found_state IS 'the state that the detectors found';

COMMENT ON COLUMN footprint_current.operator IS 'who decided the state; null where the detectors did';

COMMENT ON COLUMN footprint_current.note IS 'the operator''s reason; may be empty';

COMMENT ON COLUMN footprint_current.storeys IS 'storeys from the eaves; of runs of an older msbdb, of its tallest part [storeys]';

COMMENT ON COLUMN footprint_current.storeys_min IS 'fewest storeys that the eaves can have, if storeys are tall [storeys]';

COMMENT ON COLUMN footprint_current.storeys_max IS 'most storeys that the eaves can have, if storeys are low [storeys]';

COMMENT ON COLUMN footprint_current.storeys_top IS 'storeys of the highest eaves of its roofs of weight, as of a tower on a podium [storeys]';

COMMENT ON COLUMN footprint_current.z_ground IS 'median level of the ground around it, in the survey''s vertical reference; null where not known [m]';

COMMENT ON COLUMN footprint_current.eaves IS 'z_eaves above z_ground [m]';

COMMENT ON COLUMN footprint_current.ridge IS 'z_ridge above z_ground [m]';

COMMENT ON COLUMN footprint_current.z_eaves IS 'level of the eaves of its main roof; null where z_ground is [m]';

COMMENT ON COLUMN footprint_current.z_ridge IS 'level of the ridge of its highest roof of weight; null where z_ground is [m]';

COMMENT ON COLUMN footprint_current.h_max IS 'largest height above ground [m]';

COMMENT ON COLUMN footprint_current.h_mean IS 'mean height above ground [m]';

COMMENT ON COLUMN footprint_current.h_p50 IS 'median height above ground [m]';

COMMENT ON COLUMN footprint_current.h_p90 IS '90th percentile of the height above ground [m]';

COMMENT ON COLUMN footprint_current.area_m2 IS 'area of the footprint [m2]';

COMMENT ON COLUMN footprint_current.volume_m3 IS 'sum over the footprint''s cells of height times cell area [m3]';

COMMENT ON COLUMN footprint_current.parts IS 'number of parts, the roots included [count]';

COMMENT ON COLUMN footprint_current.flat_share IS 'share of the footprint that flat regions cover; null when this detector was not run [1]';

COMMENT ON COLUMN footprint_current.area3d_share IS 'share of the footprint that candidates of area3d cover; null when this detector was not run [1]';

COMMENT ON COLUMN footprint_current.adaptive_share IS 'share of the footprint that candidates of adaptive cover; null when this detector was not run [1]';

COMMENT ON COLUMN footprint_current.probability IS 'probability that it is a building, from the support of all detectors; null with fewer than three [1]';

COMMENT ON COLUMN footprint_current.building_id IS 'the building of the survey''s run it was copied from, which a rebuild may replace';

COMMENT ON COLUMN footprint_current.attributes IS 'attributes from an imported inventory, by the names of its columns; an empty object for none';

COMMENT ON COLUMN footprint_current.geometry IS 'outline of the roof''s edges, in the database''s CRS';

COMMENT ON VIEW part_current IS 'The parts of the present inventory. building_id is that of the building in footprint_current, also of a part that another survey found beyond the border that cuts the building.';

COMMENT ON COLUMN part_current.part_id IS 'ID: from survey, scale and absolute lattice position; above 0';

COMMENT ON COLUMN part_current.survey IS 'name of the survey';

COMMENT ON COLUMN part_current.building_id IS 'the building in footprint_current on which it stands';

COMMENT ON COLUMN part_current.supid IS 'SUPID: the father''s ID; 0 for a root';

COMMENT ON COLUMN part_current.supscale IS 'SUPSCALE: the father''s scale; 0 for a root';

COMMENT ON COLUMN part_current.root_id IS 'ID of the root of its tree';

COMMENT ON COLUMN part_current.scale IS 'SCALE: the scale on which the part exists, 1 = coarsest';

COMMENT ON COLUMN part_current.hindex IS 'H: storeys from h_p90, or with surface.storeys_from=zone the same as hzone (V18, V30) [storeys]';

COMMENT ON COLUMN part_current.hzone IS 'H by the letter of the paper: the value of the flat zone [slices]';

COMMENT ON COLUMN part_current.speindex IS 'SPE: the most frequent spectral class inside; 0 for none';

COMMENT ON COLUMN part_current.xo IS 'XO: easting of the first cell in row order [m]';

COMMENT ON COLUMN part_current.yo IS 'YO: northing of the first cell in row order [m]';

COMMENT ON COLUMN part_current.xcen IS 'XCEN: easting of the centroid of its cells [m]';

COMMENT ON COLUMN part_current.ycen IS 'YCEN: northing of the centroid of its cells [m]';

COMMENT ON COLUMN part_current.xin IS 'easting of a point that lies on the part [m]';

COMMENT ON COLUMN part_current.yin IS 'northing of a point that lies on the part [m]';

COMMENT ON COLUMN part_current.area_px IS 'number of cells [cells]';

COMMENT ON COLUMN part_current.area_m2 IS 'AREA: area of the cells [m2]';

COMMENT ON COLUMN part_current.stddis IS 'STDDIS: std of the children''s distances to the centre; null without children [m]';

COMMENT ON COLUMN part_current.h_max IS 'largest height above ground inside [m]';

COMMENT ON COLUMN part_current.h_mean IS 'mean height above ground inside [m]';

COMMENT ON COLUMN part_current.h_p50 IS 'median height above ground inside [m]';

COMMENT ON COLUMN part_current.h_p90 IS '90th percentile of the height above ground inside [m]';

COMMENT ON COLUMN part_current.h_std IS 'standard deviation of the heights inside [m]';

COMMENT ON COLUMN part_current.building_share IS 'share of its cells whose class is a building class [1]';

COMMENT ON COLUMN part_current.outline_source IS 'the outline, of roof edges: fitted to straight walls, or traced along cells where some wall would be off';

COMMENT ON COLUMN part_current.geometry IS 'outline of the roof''s edges, in the database''s CRS';

COMMENT ON VIEW building_history IS 'All versions of the inventory''s buildings, with the change by which each began and ended.';

COMMENT ON COLUMN building_history.version_id IS 'from the building and the survey or import that made it';

COMMENT ON COLUMN building_history.uid IS 'the building';

COMMENT ON COLUMN building_history.valid_from IS 'first day on which it is valid, ISO 8601';

COMMENT ON COLUMN building_history.valid_to IS 'first day on which it is no longer valid, ISO 8601; null for the current version';

COMMENT ON COLUMN building_history.source IS 'what made it: survey or import';

COMMENT ON COLUMN building_history.survey IS 'name of the survey';

COMMENT ON COLUMN building_history.began_as IS 'kind of the change by which it began: new, modified, …; or imported';

COMMENT ON COLUMN building_history.ended_in IS 'name of the survey that ended it; null for the current version';

COMMENT ON COLUMN building_history.ended_as IS 'kind of the change by which it ended: demolished, …';

COMMENT ON COLUMN building_history.state IS 'confirmed, unsure or refuted: from the probability; where it is null, from the classes and the detectors';

COMMENT ON COLUMN building_history.probability IS 'probability that it is a building, from the support of all detectors; null with fewer than three [1]';

COMMENT ON COLUMN building_history.storeys IS 'storeys from the eaves; of runs of an older msbdb, of its tallest part [storeys]';

COMMENT ON COLUMN building_history.eaves IS 'z_eaves above z_ground [m]';

COMMENT ON COLUMN building_history.ridge IS 'z_ridge above z_ground [m]';

COMMENT ON COLUMN building_history.z_ground IS 'median level of the ground around it, in the survey''s vertical reference; null where not known [m]';

COMMENT ON COLUMN building_history.h_max IS 'largest height above ground [m]';

COMMENT ON COLUMN building_history.h_p90 IS '90th percentile of the height above ground [m]';

COMMENT ON COLUMN building_history.area_m2 IS 'area of the footprint [m2]';

COMMENT ON COLUMN building_history.volume_m3 IS 'sum over the footprint''s cells of height times cell area [m3]';

COMMENT ON COLUMN building_history.geometry IS 'outline of the roof''s edges, in the database''s CRS';

COMMENT ON VIEW roof_material_by_class IS 'Cross table of roof materials and classes (V53): the number of samples on finest parts of each class, by survey; samples outside of all parts are not counted.';

COMMENT ON COLUMN roof_material_by_class.survey IS 'name of the survey';

COMMENT ON COLUMN roof_material_by_class.material IS 'the material';

COMMENT ON COLUMN roof_material_by_class.speindex IS 'SPE: the most frequent spectral class inside; 0 for none';

COMMENT ON COLUMN roof_material_by_class.class_label IS 'building, vegetation, shadow, water or other';

COMMENT ON COLUMN roof_material_by_class.samples IS 'number of samples [count]';

COMMENT ON VIEW building_piece IS 'The buildings of runs that each version of the inventory was copied from. It is one building, or several where a border of surveys cuts it: then each survey has a piece. A version that no survey measured has none.';

COMMENT ON COLUMN building_piece.version_id IS 'from the building and the survey or import that made it';

COMMENT ON COLUMN building_piece.building_id IS 'the building of a run, which a rebuild may replace';

CREATE TABLE msbdb_schema_version (version_num VARCHAR(32) NOT NULL PRIMARY KEY);

INSERT INTO msbdb_schema_version (version_num) VALUES ('0010');

