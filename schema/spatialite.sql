-- The schema 0010 of msbdb for spatialite.
-- Written by scripts/generate_schema; change msbdb.tables and the migrations instead.
-- :srid is the EPSG code of the database's one CRS, which must be in spatial_ref_sys.

SELECT InitSpatialMetaData(0, 'NONE');

CREATE TABLE inventory_building (
  uid INTEGER NOT NULL,
  source TEXT NOT NULL,
  CONSTRAINT pk_inventory_building PRIMARY KEY (uid),
  CONSTRAINT ck_inventory_building_uid CHECK (uid > 0)
);

CREATE TABLE operator_state (
  uid INTEGER NOT NULL,
  state TEXT NOT NULL,
  operator TEXT NOT NULL,
  note TEXT NOT NULL,
  decided_at TEXT NOT NULL,
  CONSTRAINT pk_operator_state PRIMARY KEY (uid),
  CONSTRAINT ck_operator_state_state CHECK (state IN ('confirmed', 'refuted')),
  CONSTRAINT ck_operator_state_operator CHECK (operator <> '')
);

CREATE TABLE roof_sample (
  sample_id INTEGER NOT NULL,
  material TEXT NOT NULL,
  note TEXT NOT NULL,
  attributes JSON,
  CONSTRAINT pk_roof_sample PRIMARY KEY (sample_id),
  CONSTRAINT ck_roof_sample_sample_id CHECK (sample_id > 0),
  CONSTRAINT ck_roof_sample_material CHECK (material <> '')
);

CREATE TABLE survey (
  survey_id INTEGER NOT NULL,
  name TEXT NOT NULL,
  date TEXT NOT NULL,
  epsg INTEGER NOT NULL,
  crs_wkt TEXT NOT NULL,
  vertical_crs TEXT NOT NULL,
  density DOUBLE NOT NULL,
  cell_m DOUBLE NOT NULL,
  west DOUBLE NOT NULL,
  south DOUBLE NOT NULL,
  east DOUBLE NOT NULL,
  north DOUBLE NOT NULL,
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
  west DOUBLE NOT NULL,
  south DOUBLE NOT NULL,
  east DOUBLE NOT NULL,
  north DOUBLE NOT NULL,
  state TEXT NOT NULL,
  points BIGINT NOT NULL,
  halo_m DOUBLE NOT NULL,
  seconds DOUBLE NOT NULL,
  reason TEXT NOT NULL,
  build TEXT NOT NULL,
  result BLOB,
  CONSTRAINT pk_tile PRIMARY KEY (survey, tile_row, tile_column),
  CONSTRAINT ck_tile_tile_bounds CHECK (west < east AND south < north),
  CONSTRAINT ck_tile_state CHECK (state IN ('queued', 'running', 'done', 'failed'))
);

CREATE TABLE building_version (
  version_id INTEGER NOT NULL,
  uid BIGINT NOT NULL,
  valid_from TEXT NOT NULL,
  valid_to TEXT,
  source TEXT NOT NULL,
  survey_id BIGINT,
  closed_by BIGINT,
  building_id BIGINT,
  state TEXT NOT NULL,
  z_ground DOUBLE,
  z_ground_min DOUBLE,
  z_ground_max DOUBLE,
  z_eaves DOUBLE,
  z_ridge DOUBLE,
  eaves DOUBLE,
  ridge DOUBLE,
  storeys BIGINT,
  storeys_min BIGINT,
  storeys_max BIGINT,
  storeys_top BIGINT,
  h_max DOUBLE,
  h_mean DOUBLE,
  h_p50 DOUBLE,
  h_p90 DOUBLE,
  area_m2 DOUBLE NOT NULL,
  volume_m3 DOUBLE,
  parts BIGINT,
  flat_share DOUBLE,
  area3d_share DOUBLE,
  adaptive_share DOUBLE,
  probability DOUBLE,
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
  number INTEGER NOT NULL,
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
  run_id INTEGER NOT NULL,
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
  dx_m DOUBLE NOT NULL,
  dy_m DOUBLE NOT NULL,
  dz_m DOUBLE NOT NULL,
  pairs BIGINT NOT NULL,
  spread_m DOUBLE,
  CONSTRAINT pk_survey_offset PRIMARY KEY (survey_id),
  CONSTRAINT ck_survey_offset_pairs CHECK (pairs >= 0),
  CONSTRAINT fk_survey_offset_survey FOREIGN KEY(survey_id) REFERENCES survey (survey_id)
);

CREATE TABLE building_change (
  change_id INTEGER NOT NULL,
  survey_id BIGINT NOT NULL,
  kind TEXT NOT NULL,
  uid_before BIGINT,
  uid_after BIGINT,
  version_before BIGINT,
  version_after BIGINT,
  outline BOOLEAN NOT NULL,
  height BOOLEAN NOT NULL,
  parts BOOLEAN NOT NULL,
  overlap_m2 DOUBLE NOT NULL,
  iou DOUBLE NOT NULL,
  dh_m DOUBLE,
  darea_m2 DOUBLE NOT NULL,
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
  candidate_id INTEGER NOT NULL,
  run_id BIGINT NOT NULL,
  method TEXT NOT NULL,
  rule TEXT NOT NULL,
  height_scale_m DOUBLE,
  points BIGINT NOT NULL,
  area_m2 DOUBLE NOT NULL,
  perimeter BIGINT NOT NULL,
  mbr_m2 DOUBLE NOT NULL,
  rectangularity DOUBLE NOT NULL,
  compactness DOUBLE,
  linearity DOUBLE,
  direction_1 DOUBLE,
  direction_2 DOUBLE,
  ndvi DOUBLE,
  h_max DOUBLE NOT NULL,
  h_mean DOUBLE NOT NULL,
  h_p50 DOUBLE NOT NULL,
  h_p90 DOUBLE NOT NULL,
  h_std DOUBLE NOT NULL,
  xcen DOUBLE NOT NULL,
  ycen DOUBLE NOT NULL,
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
  region_id INTEGER NOT NULL,
  run_id BIGINT NOT NULL,
  zone BIGINT NOT NULL,
  lambda_low_m2 DOUBLE NOT NULL,
  lambda_m2 DOUBLE NOT NULL,
  gradient_sum DOUBLE NOT NULL,
  mean_gradient DOUBLE NOT NULL,
  area_m2 DOUBLE NOT NULL,
  perimeter_m DOUBLE NOT NULL,
  compactness DOUBLE NOT NULL,
  h_max DOUBLE NOT NULL,
  h_mean DOUBLE NOT NULL,
  h_p50 DOUBLE NOT NULL,
  h_p90 DOUBLE NOT NULL,
  h_std DOUBLE NOT NULL,
  xcen DOUBLE NOT NULL,
  ycen DOUBLE NOT NULL,
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
  data BLOB NOT NULL,
  CONSTRAINT pk_raster_tile PRIMARY KEY (run_id, name, lattice_row, lattice_column),
  CONSTRAINT fk_raster_tile_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE TABLE rejection (
  rejection_id INTEGER NOT NULL,
  run_id BIGINT NOT NULL,
  region_id BIGINT NOT NULL,
  method TEXT NOT NULL,
  stage TEXT NOT NULL,
  reason TEXT NOT NULL,
  scale BIGINT NOT NULL,
  area_m2 DOUBLE NOT NULL,
  xcen DOUBLE NOT NULL,
  ycen DOUBLE NOT NULL,
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
  area_m2 DOUBLE NOT NULL,
  small BIGINT NOT NULL,
  small_m2 DOUBLE NOT NULL,
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
  data BLOB NOT NULL,
  CONSTRAINT pk_run_state PRIMARY KEY (run_id, name),
  CONSTRAINT fk_run_state_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE TABLE scale (
  run_id BIGINT NOT NULL,
  scale BIGINT NOT NULL,
  threshold_px BIGINT NOT NULL,
  threshold_m2 DOUBLE NOT NULL,
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
  share DOUBLE NOT NULL,
  ndvi DOUBLE,
  brightness DOUBLE,
  roughness_m DOUBLE,
  height_m DOUBLE NOT NULL,
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
  "plan" JSON NOT NULL,
  CONSTRAINT pk_survey_plan PRIMARY KEY (run_id),
  CONSTRAINT fk_survey_plan_run FOREIGN KEY(run_id) REFERENCES run (run_id) ON DELETE CASCADE
);

CREATE TABLE building (
  building_id INTEGER NOT NULL,
  run_id BIGINT NOT NULL,
  state TEXT NOT NULL,
  probability DOUBLE,
  z_ground DOUBLE,
  z_ground_min DOUBLE,
  z_ground_max DOUBLE,
  z_eaves DOUBLE,
  z_ridge DOUBLE,
  eaves DOUBLE,
  ridge DOUBLE,
  storeys BIGINT NOT NULL,
  storeys_min BIGINT,
  storeys_max BIGINT,
  storeys_top BIGINT,
  h_max DOUBLE NOT NULL,
  h_mean DOUBLE NOT NULL,
  h_p50 DOUBLE NOT NULL,
  h_p90 DOUBLE NOT NULL,
  area_m2 DOUBLE NOT NULL,
  volume_m3 DOUBLE NOT NULL,
  floor_area_m2 DOUBLE,
  trees BIGINT NOT NULL,
  parts BIGINT NOT NULL,
  scales BIGINT NOT NULL,
  speindex BIGINT NOT NULL,
  class_id BIGINT GENERATED ALWAYS AS (nullif(speindex, 0)) STORED,
  building_share DOUBLE NOT NULL,
  xcen DOUBLE NOT NULL,
  ycen DOUBLE NOT NULL,
  xin DOUBLE NOT NULL,
  yin DOUBLE NOT NULL,
  multiscale_share DOUBLE,
  flat_share DOUBLE,
  area3d_share DOUBLE,
  adaptive_share DOUBLE,
  coverage DOUBLE,
  nodata_share DOUBLE,
  density DOUBLE,
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
  overlap_m2 DOUBLE NOT NULL,
  region_share DOUBLE NOT NULL,
  candidate_share DOUBLE NOT NULL,
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
  mean DOUBLE NOT NULL,
  CONSTRAINT pk_spectral_class_band PRIMARY KEY (run_id, speindex, band),
  CONSTRAINT fk_spectral_class_band_spectral_class FOREIGN KEY(run_id, speindex) REFERENCES spectral_class (run_id, speindex) ON DELETE CASCADE
);

CREATE TABLE part (
  part_id INTEGER NOT NULL,
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
  xo DOUBLE NOT NULL,
  yo DOUBLE NOT NULL,
  xcen DOUBLE NOT NULL,
  ycen DOUBLE NOT NULL,
  xin DOUBLE NOT NULL,
  yin DOUBLE NOT NULL,
  area_px BIGINT NOT NULL,
  area_m2 DOUBLE NOT NULL,
  stddis DOUBLE,
  h_max DOUBLE NOT NULL,
  h_mean DOUBLE NOT NULL,
  h_p50 DOUBLE NOT NULL,
  h_p90 DOUBLE NOT NULL,
  h_std DOUBLE NOT NULL,
  building_share DOUBLE NOT NULL,
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
  overlap_m2 DOUBLE NOT NULL,
  part_share DOUBLE NOT NULL,
  candidate_share DOUBLE NOT NULL,
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
  overlap_m2 DOUBLE NOT NULL,
  part_share DOUBLE NOT NULL,
  region_share DOUBLE NOT NULL,
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

SELECT AddGeometryColumn('part', 'geometry', :srid, 'MULTIPOLYGON', 'XY', 1);

SELECT CreateSpatialIndex('part', 'geometry');

SELECT AddGeometryColumn('building', 'geometry', :srid, 'MULTIPOLYGON', 'XY', 1);

SELECT CreateSpatialIndex('building', 'geometry');

SELECT AddGeometryColumn('rejection', 'geometry', :srid, 'POINT', 'XY', 1);

SELECT CreateSpatialIndex('rejection', 'geometry');

SELECT AddGeometryColumn('flat_region', 'geometry', :srid, 'MULTIPOLYGON', 'XY', 1);

SELECT CreateSpatialIndex('flat_region', 'geometry');

SELECT AddGeometryColumn('candidate_region', 'geometry', :srid, 'MULTIPOLYGON', 'XY', 1);

SELECT CreateSpatialIndex('candidate_region', 'geometry');

SELECT AddGeometryColumn('building_version', 'geometry', :srid, 'MULTIPOLYGON', 'XY', 1);

SELECT CreateSpatialIndex('building_version', 'geometry');

SELECT AddGeometryColumn('inventory_event', 'geometry', :srid, 'MULTIPOLYGON', 'XY', 1);

SELECT CreateSpatialIndex('inventory_event', 'geometry');

SELECT AddGeometryColumn('roof_sample', 'geometry', :srid, 'POINT', 'XY', 1);

SELECT CreateSpatialIndex('roof_sample', 'geometry');

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

INSERT INTO views_geometry_columns (view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only) VALUES ('footprint', 'geometry', 'building_id', 'building', 'geometry', 1);

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

INSERT INTO views_geometry_columns (view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only) VALUES ('part_tree', 'geometry', 'part_id', 'part', 'geometry', 1);

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

INSERT INTO views_geometry_columns (view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only) VALUES ('building_summary', 'geometry', 'building_id', 'building', 'geometry', 1);

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

INSERT INTO views_geometry_columns (view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only) VALUES ('part_evidence', 'geometry', 'part_id', 'part', 'geometry', 1);

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

INSERT INTO views_geometry_columns (view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only) VALUES ('unexplained_flat_region', 'geometry', 'region_id', 'flat_region', 'geometry', 1);

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

INSERT INTO views_geometry_columns (view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only) VALUES ('candidate_evidence', 'geometry', 'candidate_id', 'candidate_region', 'geometry', 1);

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

INSERT INTO views_geometry_columns (view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only) VALUES ('unexplained_candidate', 'geometry', 'candidate_id', 'candidate_region', 'geometry', 1);

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

INSERT INTO views_geometry_columns (view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only) VALUES ('building_evidence', 'geometry', 'building_id', 'building', 'geometry', 1);

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

INSERT INTO views_geometry_columns (view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only) VALUES ('footprint_current', 'geometry', 'version_id', 'building_version', 'geometry', 1);

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

INSERT INTO views_geometry_columns (view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only) VALUES ('part_current', 'geometry', 'part_id', 'part', 'geometry', 1);

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

INSERT INTO views_geometry_columns (view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only) VALUES ('building_history', 'geometry', 'version_id', 'building_version', 'geometry', 1);

CREATE TABLE msbdb_schema_version (version_num VARCHAR(32) NOT NULL PRIMARY KEY);

INSERT INTO msbdb_schema_version (version_num) VALUES ('0010');

