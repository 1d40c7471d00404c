<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology">
  <renderer-v2 type="singleSymbol" forceraster="0" symbollevels="0" enableorderby="0">
    <symbols>
      <symbol type="marker" name="0" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <prop k="name" v="circle"/>
          <prop k="color" v="23,33,43,255"/>
          <prop k="outline_style" v="no"/>
          <prop k="size" v="0.8"/>
          <prop k="size_unit" v="MM"/>
        </layer>
        <layer class="VectorField" enabled="1" locked="0" pass="0">
          <prop k="x_attribute" v="shift_x_m"/>
          <prop k="y_attribute" v="shift_y_m"/>
          <prop k="vector_field_type" v="0"/>
          <prop k="distance_unit" v="MM"/>
          <prop k="scale" v="$mm_a_metre"/>
          <prop k="angle_orientation" v="0"/>
          <prop k="angle_units" v="0"/>
          <prop k="size" v="1"/>
          <prop k="offset" v="0,0"/>
          <symbol type="line" name="@0@1" alpha="1" clip_to_extent="1" force_rhr="0">
            <layer class="ArrowLine" enabled="1" locked="0" pass="0">
              <prop k="arrow_width" v="0.25"/>
              <prop k="arrow_start_width" v="0.25"/>
              <prop k="arrow_width_unit" v="MM"/>
              <prop k="arrow_start_width_unit" v="MM"/>
              <prop k="head_length" v="1.1"/>
              <prop k="head_length_unit" v="MM"/>
              <prop k="head_thickness" v="0.5"/>
              <prop k="head_thickness_unit" v="MM"/>
              <prop k="head_type" v="0"/>
              <prop k="arrow_type" v="0"/>
              <prop k="is_curved" v="0"/>
              <prop k="is_repeated" v="0"/>
              <symbol type="fill" name="@@0@1@0" alpha="1" clip_to_extent="1" force_rhr="0">
                <layer class="SimpleFill" enabled="1" locked="0" pass="0">
                  <prop k="color" v="29,95,209,255"/>
                  <prop k="style" v="solid"/>
                  <prop k="outline_style" v="no"/>
                </layer>
              </symbol>
            </layer>
          </symbol>
        </layer>
      </symbol>
    </symbols>
  </renderer-v2>
</qgis>
