<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22" labelsEnabled="1" styleCategories="Symbology|Labeling|Fields|Forms|AttributeTable">
  <renderer-v2 type="RuleRenderer">
    <rules key="places">
      <rule key="decided" label="decided" symbol="3" filter="coalesce(attribute($currentfeature, 'verdict'), '') &lt;&gt; ''"/>
      <rule key="unknown" label="nothing can be said" symbol="4" filter="coalesce(attribute($currentfeature, 'verdict'), '') = '' AND &quot;reason&quot; = 'nothing can be said of this area'"/>
      <rule key="first" label="rank 1 to 10" symbol="0" filter="coalesce(attribute($currentfeature, 'verdict'), '') = '' AND &quot;reason&quot; &lt;&gt; 'nothing can be said of this area' AND &quot;rank&quot; &lt;= 10"/>
      <rule key="next" label="rank 11 to 50" symbol="1" filter="coalesce(attribute($currentfeature, 'verdict'), '') = '' AND &quot;reason&quot; &lt;&gt; 'nothing can be said of this area' AND &quot;rank&quot; &gt; 10 AND &quot;rank&quot; &lt;= 50"/>
      <rule key="last" label="rank from 51" symbol="2" filter="coalesce(attribute($currentfeature, 'verdict'), '') = '' AND &quot;reason&quot; &lt;&gt; 'nothing can be said of this area' AND &quot;rank&quot; &gt; 50"/>
    </rules>
    <symbols>
      <symbol name="0" type="fill" alpha="1"><layer class="SimpleFill" enabled="1"><Option type="Map"><Option name="color" type="QString" value="215,25,28,80"/><Option name="outline_color" type="QString" value="215,25,28,255"/><Option name="outline_width" type="QString" value="0.5"/><Option name="outline_width_unit" type="QString" value="MM"/><Option name="style" type="QString" value="solid"/><Option name="outline_style" type="QString" value="solid"/></Option></layer></symbol>
      <symbol name="1" type="fill" alpha="1"><layer class="SimpleFill" enabled="1"><Option type="Map"><Option name="color" type="QString" value="253,141,60,80"/><Option name="outline_color" type="QString" value="253,141,60,255"/><Option name="outline_width" type="QString" value="0.5"/><Option name="outline_width_unit" type="QString" value="MM"/><Option name="style" type="QString" value="solid"/><Option name="outline_style" type="QString" value="solid"/></Option></layer></symbol>
      <symbol name="2" type="fill" alpha="1"><layer class="SimpleFill" enabled="1"><Option type="Map"><Option name="color" type="QString" value="254,217,118,80"/><Option name="outline_color" type="QString" value="254,217,118,255"/><Option name="outline_width" type="QString" value="0.5"/><Option name="outline_width_unit" type="QString" value="MM"/><Option name="style" type="QString" value="solid"/><Option name="outline_style" type="QString" value="solid"/></Option></layer></symbol>
      <symbol name="3" type="fill" alpha="1"><layer class="SimpleFill" enabled="1"><Option type="Map"><Option name="color" type="QString" value="120,120,120,80"/><Option name="outline_color" type="QString" value="120,120,120,255"/><Option name="outline_width" type="QString" value="0.5"/><Option name="outline_width_unit" type="QString" value="MM"/><Option name="style" type="QString" value="solid"/><Option name="outline_style" type="QString" value="solid"/></Option></layer></symbol>
      <symbol name="4" type="fill" alpha="1"><layer class="SimpleFill" enabled="1"><Option type="Map"><Option name="color" type="QString" value="120,120,120,80"/><Option name="outline_color" type="QString" value="120,120,120,255"/><Option name="outline_width" type="QString" value="0.5"/><Option name="outline_width_unit" type="QString" value="MM"/><Option name="style" type="QString" value="b_diagonal"/><Option name="outline_style" type="QString" value="solid"/></Option></layer></symbol>
    </symbols>
  </renderer-v2>
  <labeling type="simple">
    <settings>
      <text-style fieldName="rank" fontSize="10" fontSizeUnit="Point" textColor="60,0,0,255">
        <text-buffer bufferDraw="1" bufferSize="0.8" bufferSizeUnits="MM" bufferColor="255,255,255,255"/>
      </text-style>
    </settings>
  </labeling>
  <fieldConfiguration>
    <field name="verdict">
      <editWidget type="ValueMap">
        <config><Option type="Map"><Option name="map" type="List"><Option type="Map"><Option name="not decided" type="QString" value=""/></Option><Option type="Map"><Option name="ground" type="QString" value="ground"/></Option><Option type="Map"><Option name="object" type="QString" value="object"/></Option><Option type="Map"><Option name="bridge" type="QString" value="bridge"/></Option><Option type="Map"><Option name="water" type="QString" value="water"/></Option><Option type="Map"><Option name="fine" type="QString" value="fine"/></Option></Option></Option></config>
      </editWidget>
    </field>
  </fieldConfiguration>
  <attributetableconfig sortExpression="&quot;rank&quot;" sortOrder="0">
    <columns><column type="field" name="fid" hidden="1" width="-1"/><column type="field" name="rank" hidden="0" width="60"/><column type="field" name="verdict" hidden="0" width="110"/><column type="field" name="reason" hidden="0" width="300"/><column type="field" name="area" hidden="0" width="80"/><column type="field" name="volume" hidden="0" width="80"/><column type="field" name="chance" hidden="0" width="80"/><column type="field" name="x" hidden="0" width="100"/><column type="field" name="y" hidden="0" width="100"/></columns>
  </attributetableconfig>
</qgis>
